"""Faults that ingest has repaired: gaps in the time stamps, and invalid readings."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, sqrt

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.selection import Outcome
from piezoid.records.recording import Recording

STAMP_FAULTS = ("gap", "duplicate_time", "time_reversed")
INVALID = "lost_readings"
CERTAIN_P = 1e-12  # time stamps and flags are read, not estimated
CLOCK, SPIKES = "timestamp_fault", "outliers"


def with_ingest_faults(
    outcome: Outcome, recordings: Sequence[Recording], half_stroke_m: float
) -> Outcome:
    """Add the faults that ingest detected and repaired to the outcome of a search.

    The size of a clock fault is the number of samples that are missing, have a repeated stamp, or
    by which the clock stepped back, plus the samples of a slip. The size of invalid readings is
    their largest distance from the motion, in nm.

    recordings     the searched recordings
    half_stroke_m  half the range of the displacement
    """
    statements = [(r.name, s) for r in recordings for s in r.statements]
    faults, tracks = dict(outcome.faults), outcome.clean.tracks
    stamps = [(name, s.value) for name, s in statements if s.quantity in STAMP_FAULTS]
    counts = [value for _, value in stamps if value]
    if counts:
        slip = faults.pop(CLOCK, None)
        clock = Fault(
            tracks=tracks if slip is None else slip.tracks,
            value=sum(counts) + (abs(slip.value) if slip else 0.0),
            # each number is rounded to whole samples
            spread=hypot(sqrt(len(counts) / 12.0), slip.spread if slip else 0.0),
            p_value=CERTAIN_P,
            locations=tuple(
                dict.fromkeys([n for n, _ in stamps] + list(slip.locations if slip else ()))
            ),
        )
        faults = {CLOCK: clock, **faults}
    invalid = [(name, s) for name, s in statements if s.quantity == INVALID]
    if invalid:
        largest_nm = 1e9 * max(statement.value or 0.0 for _, statement in invalid)
        spikes = faults.pop(SPIKES, None)
        readings = Fault(
            tracks=tracks if spikes is None else spikes.tracks,
            value=largest_nm,
            # the error of the true reading is the noise
            spread=max(1e9 * outcome.final.noise * half_stroke_m, 0.01 * largest_nm),
            p_value=CERTAIN_P,
            locations=tuple(f"{name}: {statement.text}" for name, statement in invalid),
        )
        faults = {SPIKES: readings.merged_with(spikes), **faults}
    return replace(outcome, faults=faults)
