"""Independent jobs of a stage: fit, diagnose and design one axis, or the tip."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.design.design_stage import AxisDesignResult
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.identification.model import AxisModel
    from piezoid.identification.tunnelling.model import TunnellingModel
    from piezoid.records.collection import Collection
    from piezoid.records.frequency_response import FrequencyResponseRecord
    from piezoid.records.lab import Lab
    from piezoid.records.recording import Recording
    from piezoid.records.table import RawTable

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class AxisJob:
    """An axis to be fitted, diagnosed and designed.

    stage       without any axis
    recordings  that hold the axis, and no others
    response    of the axis, where one was measured
    threads     so many diagnose it; what they find does not depend on it
    """

    stage: "ActuatorModel"
    axis: str
    recordings: "Sequence[Recording]"
    lab: "Lab | None"
    response: "FrequencyResponseRecord | None" = None
    threads: int = 1


@dataclass(frozen=True, kw_only=True)
class TipJob:
    """The tunnelling tip, to be fitted and designed.

    stage       without any axis
    recordings  closed loops
    sweeps      over height
    axes        names of the stage's other axes: a tip of that name is not designed twice
    """

    stage: "ActuatorModel"
    recordings: "Sequence[Recording]"
    sweeps: "Sequence[RawTable]"
    axes: tuple[str, ...]
    lab: "Lab | None"


@dataclass(frozen=True, kw_only=True)
class Designed:
    """What came of designing one axis.

    outcomes  of the axis; none where there was nothing to design
    fault     what else ended it
    """

    outcomes: "tuple[AxisDesignResult, ...]" = ()
    fault: Exception | None = None


@dataclass(frozen=True, kw_only=True)
class AxisResult:
    """What one axis is.

    model        with everything in it that the diagnosis found
    diagnosis    None where there is none, and ``undiagnosed`` says why
    stumbled     a fault of ours ended the diagnosis
    """

    model: "AxisModel"
    diagnosis: "Diagnosis | None"
    undiagnosed: str
    stumbled: bool
    designed: Designed


@dataclass(frozen=True, kw_only=True)
class TipResult:
    """What the tip is; None where there is none."""

    tunnelling: "TunnellingModel | None"
    designed: Designed


def jobs_of(
    collection: "Collection",
    lab: "Lab | None",
    processes: int = 1,
    progress: Progress = lambda _: None,
) -> "tuple[ActuatorModel, list[AxisJob | TipJob]]":
    """Return the stage before any fit of an axis, and what is to be done of it: the tip first.

    Where lab.toml says that axes are coupled, the stage holds the model of the coupling already,
    and the axes are fitted in the coordinates that it decouples.

    processes  of those that do the jobs; where there are fewer axes, each has threads instead

    Raises what ``fit`` raises where there is nothing to fit.
    """
    from piezoid.identification.fit import prepare_fit, recorded_of, response_of
    from piezoid.identification.tunnelling.loop_files import is_loop
    from piezoid.records.lab import Lab

    declared = lab or Lab()
    inputs = prepare_fit(
        collection.recordings, declared, collection.sweeps, collection.responses, progress=progress
    )
    stage, axes = inputs.stage, inputs.axes
    tip = TipJob(
        stage=stage,
        recordings=tuple(filter(is_loop, collection.recordings)),
        sweeps=collection.sweeps,
        axes=axes,
        lab=lab,
    )
    ways = [
        AxisJob(
            stage=stage,
            axis=axis,
            recordings=recorded_of(inputs.recordings, axis),
            lab=lab,
            response=response_of(inputs.responses, axis, axes),
            threads=max(processes // len(axes), 1),
        )
        for axis in axes
    ]
    return stage, [*([tip] if tip.recordings or tip.sweeps else []), *ways]


def preload() -> None:
    """Load the modules that a job needs, while the recordings are still being read."""
    import piezoid.design.design_stage
    import piezoid.diagnosis.diagnose
    import piezoid.identification.fit  # noqa: F401


def estimated_cost(job: "AxisJob | TipJob") -> float:
    """Return the relative run time of a job: samples of the axis, and 0 for the tip."""
    if isinstance(job, TipJob):
        return 0.0
    return float(sum(recording.samples for recording in job.recordings))


def run_job(job: "AxisJob | TipJob", progress: Progress) -> "AxisResult | TipResult":
    """Do all that needs nothing of the other axes.

    Raises what fitting raises; whatever a diagnosis or a design stumbles over, the model is there
    without it.
    """
    return _run_axis(job, progress) if isinstance(job, AxisJob) else _run_tip(job, progress)


def _run_axis(job: AxisJob, progress: Progress) -> AxisResult:
    from piezoid.identification.fit import fit_axis, moving
    from piezoid.identification.loop_shape_fit import with_loop_shape
    from piezoid.raw_counts import errors_in_counts, in_counts, texts_in_counts
    from piezoid.records.lab import Lab
    from piezoid.records.recording import counted_in

    def of_axis(text: str) -> None:
        progress(f"axis {job.axis}: {text}")

    with errors_in_counts(counted_in(job.recordings)):
        model = fit_axis(
            job.recordings,
            job.axis,
            job.lab or Lab(),
            response=job.response,
            has_loop_shape=False,
            progress=of_axis,
        )
    diagnosis, missing, stumbled = _diagnosed(job, model, of_axis)
    if diagnosis is not None and diagnosis.model is not None:
        model = diagnosis.model
    else:
        of_axis("loop shape")
        model = with_loop_shape(model, moving(job.recordings, job.axis))
    return AxisResult(
        model=texts_in_counts(model),
        diagnosis=None if diagnosis is None else texts_in_counts(diagnosis),
        undiagnosed=in_counts(missing, model.counted),
        stumbled=stumbled,
        designed=_designed(replace(job.stage, axes={job.axis: model}), job.lab, progress),
    )


def _diagnosed(
    job: AxisJob, model: "AxisModel", progress: Progress
) -> "tuple[Diagnosis | None, str, bool]":
    """Return the diagnosis, or why there is none and whether that is our fault."""
    from piezoid.diagnosis.diagnose import diagnose
    from piezoid.errors import PiezoidError

    refused = f"axis {job.axis} is not diagnosed"
    try:
        diagnosis = diagnose(
            job.recordings,
            axis=job.axis,
            lab=job.lab,
            model=model,
            response=job.response,
            progress=progress,
            threads=job.threads,
        )
    except PiezoidError as refusal:
        return None, f"{refused}: {refusal}", False
    except Exception as error:  # an internal error must not cost the lab its model
        return None, f"{refused}: internal error ({type(error).__name__}: {error})", True
    return diagnosis, "", False


def _run_tip(job: TipJob, progress: Progress) -> TipResult:
    from piezoid.design.junction_task import axis_of
    from piezoid.identification.tunnelling.junction import fit_junction
    from piezoid.records.lab import Lab

    progress("fitting the tunnelling current")
    tunnelling = fit_junction(job.sweeps, job.recordings, job.lab or Lab())
    if tunnelling is None or axis_of(tunnelling) in job.axes:
        return TipResult(tunnelling=tunnelling, designed=Designed())
    stage = replace(job.stage, tunnelling=tunnelling)
    return TipResult(tunnelling=tunnelling, designed=_designed(stage, job.lab, progress))


def _designed(stage: "ActuatorModel", lab: "Lab | None", progress: Progress) -> Designed:
    from piezoid.design.design_stage import design_axes

    try:
        return Designed(outcomes=design_axes(stage, lab=lab, progress=progress))
    except Exception as fault:  # told where the controllers of the whole stage are
        return Designed(fault=fault)
