"""What time stamps tell of lost samples, beside slips that only the readings tell."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.search import Outcome
from piezoid.records.recording import Recording

KINDS = ("gap", "duplicate_time", "time_reversed")
READ = 1e-12  # what is read from the stamps is no chance
NAME = "timestamp_fault"


def with_stamps(outcome: Outcome, recordings: Sequence[Recording]) -> Outcome:
    """Return what a search came to, with the faults of the clock that ingest met.

    recordings  those that were searched

    The size is the number of samples that are missing, have the stamp before again, or by which a
    clock stepped back; the samples of a slip come on top. Ingest has repaired them already: single
    samples are bridged, memory ends at all else.
    """
    told = [p.samples for r in recordings for p in r.problems if p.kind in KINDS]
    if not any(told):
        return outcome
    slip = outcome.faults.get(NAME)
    where = [r.name for r in recordings if any(p.kind in KINDS for p in r.problems)]
    fault = Fault(
        tracks=outcome.clean.tracks if slip is None else slip.tracks,
        value=float(sum(told)) + (abs(slip.value) if slip else 0.0),
        # each number is rounded to whole samples
        spread=hypot(sqrt(len(told) / 12.0), slip.spread if slip else 0.0),
        p_value=READ,
        where=tuple(dict.fromkeys([*where, *(slip.where if slip else ())])),
    )
    return replace(outcome, faults={NAME: fault, **_but(outcome.faults)})


def _but(faults: Mapping[str, Fault]) -> dict[str, Fault]:
    return {name: fault for name, fault in faults.items() if name != NAME}
