"""diagnosis.html: the causes in recordings, each drawn on a model of those very recordings."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.identification.model import AxisModel
    from piezoid.records.lab import Lab
    from piezoid.records.recording import Recording

QUICK = ((8, 2),)  # plays, dead zones a side: enough to see a cause on, tried without a choice
ON_QUICK = (
    "The pictures are drawn on a quick fit of eight plays, made for them; the errors in the "
    "tables are those of the diagnosis. piezoid fit draws them on the whole model."
)


def diagnosis_page(
    found: "Diagnosis",
    recordings: "Sequence[Recording]",
    lab: "Lab | None",
    written: bytes,
    told: Callable[[str], None],
) -> str:
    """Return the page of one diagnosis.

    recordings  that were diagnosed
    lab         what the laboratory declares
    written     diagnosis.json, for the chain of digests
    told        told what is being done: without a model, one is fitted quickly to draw on
    """
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid_reports.render import render_diagnosis

    drawn = found.model
    if drawn is None and found.findings:
        told("fitting a quick model to draw the causes on")
        drawn = _quick(recordings, found.axis, lab)
    model = ActuatorModel(
        stage=(lab.name if lab is not None else "") or recordings[0].name,
        axes={} if drawn is None else {found.axis: drawn},
        sources={recording.name: recording.digest for recording in recordings},
        lab=None if lab is None else lab.digest or None,
    )
    note = ON_QUICK if drawn is not None and found.model is None else ""
    return render_diagnosis(model, recordings, found, note=note, written=written)


def _quick(recordings: "Sequence[Recording]", axis: str, lab: "Lab | None") -> "AxisModel | None":
    """Fit one order and judge nothing; None where even that has no answer."""
    from piezoid.errors import PiezoidError
    from piezoid.identification.fit import moving, rig_of
    from piezoid.identification.hysteresis.estimate import estimate_axis
    from piezoid.records.lab import Lab

    rig = rig_of(lab or Lab(), axis)
    try:
        fitted = estimate_axis(moving(recordings, axis), axis, rig, orders=QUICK)
    except PiezoidError:
        return None
    return replace(fitted, verdict=replace(fitted.verdict, applies=True, reason="", remarks=()))
