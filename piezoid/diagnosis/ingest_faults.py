"""What ingest met before any model: faults of the time stamps, and readings that are none."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.selection import Outcome
from piezoid.records.recording import Recording

KINDS = ("gap", "duplicate_time", "time_reversed")
READ = 1e-12  # what is read from the stamps is no chance
NAME = "timestamp_fault"
LOST = "lost_readings"
SPIKES = "outliers"


def with_ingested(outcome: Outcome, recordings: Sequence[Recording], stroke_m: float) -> Outcome:
    """Return what a search came to, with the faults that ingest met and repaired.

    recordings  those that were searched
    stroke_m    half the range of the displacement
    """
    return _with_lost(_with_stamps(outcome, recordings), recordings, stroke_m)


def _with_stamps(outcome: Outcome, recordings: Sequence[Recording]) -> Outcome:
    """Add what the clocks say.

    The size is the number of samples that are missing, have the stamp before again, or by which a
    clock stepped back; the samples of a slip come on top. Ingest has repaired them already: single
    samples are bridged, memory ends at all else.
    """
    counts = [s.value for r in recordings for s in r.statements if s.quantity in KINDS and s.value]
    if not counts:
        return outcome
    slip = outcome.faults.get(NAME)
    where = [r.name for r in recordings if any(s.quantity in KINDS for s in r.statements)]
    fault = Fault(
        tracks=outcome.clean.tracks if slip is None else slip.tracks,
        value=sum(counts) + (abs(slip.value) if slip else 0.0),
        # each number is rounded to whole samples
        spread=hypot(sqrt(len(counts) / 12.0), slip.spread if slip else 0.0),
        p_value=READ,
        where=tuple(dict.fromkeys([*where, *(slip.where if slip else ())])),
    )
    return replace(outcome, faults={NAME: fault, **_but(outcome.faults, NAME)})


def _with_lost(outcome: Outcome, recordings: Sequence[Recording], stroke_m: float) -> Outcome:
    """Add readings that are no measurement; the size is how far the farthest stands off, nm."""
    lost = [(r.name, s) for r in recordings for s in r.statements if s.quantity == LOST]
    if not lost:
        return outcome
    tracks = outcome.clean.tracks
    farthest_nm = 1e9 * max(statement.value or 0.0 for _, statement in lost)
    fault = Fault(
        tracks=tracks,
        value=farthest_nm,
        # what would have been read there is known to the noise
        spread=max(1e9 * outcome.final.noise * stroke_m, 0.01 * farthest_nm),
        p_value=READ,
        where=tuple(f"{name}: {statement.text}" for name, statement in lost),
    )
    spikes = outcome.faults.get(SPIKES)
    if spikes is not None:
        fault = replace(fault, tracks=spikes.tracks).after(spikes)
    return replace(outcome, faults={SPIKES: fault, **_but(outcome.faults, SPIKES)})


def _but(faults: Mapping[str, Fault], name: str) -> dict[str, Fault]:
    return {other: fault for other, fault in faults.items() if other != name}
