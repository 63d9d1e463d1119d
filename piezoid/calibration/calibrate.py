"""Calibrate a stage: from recordings to the sealed files of its folder, without the report.

``jobs_of`` splits a stage into independent jobs: each axis, or the tip, is fitted, diagnosed and
designed by ``run_job``. ``finish`` exports and verifies the stage.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from piezoid.calibration.controllers import Controllers, controllers_of
from piezoid.design.design_stage import AxisDesignResult, design_axes
from piezoid.design.junction_task import axis_of
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.errors import PiezoidError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.fit import (
    driven_recordings,
    fit_axis,
    prepare_fit,
    recordings_of_axis,
    response_of,
)
from piezoid.identification.loop_shape_fit import with_loop_shape
from piezoid.identification.model import AxisModel
from piezoid.identification.store import write_model
from piezoid.identification.tunnelling.junction import TunnellingModel, fit_junction
from piezoid.identification.tunnelling.loop_files import is_loop
from piezoid.output_folder import add_to_folder
from piezoid.raw_counts import errors_in_counts, in_counts, texts_in_counts
from piezoid.records.collection import Collection
from piezoid.records.frequency_response import FrequencyResponseRecord
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording, counted_in
from piezoid.records.table import RawTable

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class AxisJob:
    """An axis to fit, diagnose and design.

    stage       without any axis
    recordings  of the axis
    response    measured frequency response of the axis
    threads     of the diagnosis; its result does not depend on them
    """

    stage: ActuatorModel
    axis: str
    recordings: Sequence[Recording]
    lab: Lab | None
    response: FrequencyResponseRecord | None = None
    threads: int = 1


@dataclass(frozen=True, kw_only=True)
class TipJob:
    """The tunnelling tip, to fit and design.

    stage       without any axis
    recordings  closed loops
    sweeps      over height
    axes        names of the stage's other axes: a tip of that name is not designed twice
    """

    stage: ActuatorModel
    recordings: Sequence[Recording]
    sweeps: Sequence[RawTable]
    axes: tuple[str, ...]
    lab: Lab | None


@dataclass(frozen=True, kw_only=True)
class JobResult:
    """Result of a job.

    model        of an axis, with the effects of its diagnosis
    tunnelling   of the tip
    undiagnosed  reason for a missing diagnosis
    outcomes     of the design; empty if there was nothing to design
    fault        error that ended the design
    has_crashed  whether an internal error ended the diagnosis
    """

    model: AxisModel | None = None
    tunnelling: TunnellingModel | None = None
    diagnosis: Diagnosis | None = None
    undiagnosed: str = ""
    outcomes: tuple[AxisDesignResult, ...] = ()
    fault: Exception | None = None
    has_crashed: bool = False


def jobs_of(
    collection: Collection,
    lab: Lab | None,
    processes: int = 1,
    progress: Progress = lambda _: None,
) -> tuple[ActuatorModel, list[AxisJob | TipJob]]:
    """Return the stage without axes, and its jobs: the tip first.

    If lab.toml declares coupled axes, the stage contains the model of the coupling, and the axes
    are fitted in decoupled coordinates.

    processes  number of processes that share the jobs; with fewer axes, each axis has threads

    Raises what ``fit`` raises if there is nothing to fit.
    """
    inputs = prepare_fit(
        collection.recordings,
        lab or Lab(),
        collection.sweeps,
        collection.responses,
        progress=progress,
    )
    jobs: list[AxisJob | TipJob] = []
    loops = tuple(filter(is_loop, collection.recordings))
    if loops or collection.sweeps:
        jobs.append(
            TipJob(
                stage=inputs.stage,
                recordings=loops,
                sweeps=collection.sweeps,
                axes=inputs.axes,
                lab=lab,
            )
        )
    jobs += [
        AxisJob(
            stage=inputs.stage,
            axis=axis,
            recordings=recordings_of_axis(inputs.recordings, axis),
            lab=lab,
            response=response_of(inputs.responses, axis, inputs.axes),
            threads=max(processes // len(inputs.axes), 1),
        )
        for axis in inputs.axes
    ]
    return inputs.stage, jobs


def estimated_cost(job: AxisJob | TipJob) -> float:
    """Return the relative run time of a job: samples of the axis, and 0 for the tip."""
    if isinstance(job, TipJob):
        return 0.0
    return float(sum(recording.samples for recording in job.recordings))


def run_job(job: AxisJob | TipJob, progress: Progress) -> JobResult:
    """Fit, diagnose and design an axis, or fit and design the tip.

    Raises what fitting raises; an error of the diagnosis or the design is part of the result.
    """
    if isinstance(job, TipJob):
        progress("fitting the tunnelling current")
        tunnelling = fit_junction(job.sweeps, job.recordings, job.lab or Lab())
        if tunnelling is None or axis_of(tunnelling) in job.axes:
            return JobResult(tunnelling=tunnelling)
        stage = replace(job.stage, tunnelling=tunnelling)
        outcomes, fault = try_design(stage, job.lab, progress)
        return JobResult(tunnelling=tunnelling, outcomes=outcomes, fault=fault)
    axis = job.axis

    def report(text: str) -> None:
        progress(f"axis {axis}: {text}")

    with errors_in_counts(counted_in(job.recordings)):
        model = fit_axis(
            job.recordings,
            axis,
            job.lab or Lab(),
            response=job.response,
            has_loop_shape=False,
            progress=report,
        )
    diagnosis, undiagnosed, has_crashed = None, "", False
    try:
        diagnosis = diagnose(
            job.recordings,
            axis=axis,
            lab=job.lab,
            model=model,
            response=job.response,
            progress=report,
            threads=job.threads,
        )
    except PiezoidError as refusal:
        undiagnosed = f"axis {axis} is not diagnosed: {refusal}"
    except Exception as error:  # an internal error must not cost the lab its model
        reason = f"internal error ({type(error).__name__}: {error})"
        undiagnosed, has_crashed = f"axis {axis} is not diagnosed: {reason}", True
    if diagnosis is not None and diagnosis.model is not None:
        model = diagnosis.model
    else:
        report("loop shape")
        model = with_loop_shape(model, driven_recordings(job.recordings, axis))
    outcomes, fault = try_design(replace(job.stage, axes={axis: model}), job.lab, progress)
    return JobResult(
        model=texts_in_counts(model),
        diagnosis=None if diagnosis is None else texts_in_counts(diagnosis),
        undiagnosed=in_counts(undiagnosed, model.counted),
        outcomes=outcomes,
        fault=fault,
        has_crashed=has_crashed,
    )


def try_design(
    stage: ActuatorModel, lab: Lab | None, progress: Progress
) -> tuple[tuple[AxisDesignResult, ...], Exception | None]:
    """Return the outcomes of designing the axes of a stage, or the error that ended it."""
    try:
        return design_axes(stage, lab=lab, progress=progress), None
    except Exception as fault:  # raised again when the controllers of the stage are assembled
        return (), fault


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Results for one stage, from its recordings to the verification.

    diagnoses    of the axes that could be diagnosed, in their order
    undiagnosed  reasons for missing diagnoses, as sentences
    controllers  design, parameters and verification, or the reason for missing controllers
    has_crashed  whether an internal error ended a diagnosis or the design
    files        contents of the files of the folder, by name
    """

    model: ActuatorModel
    diagnoses: tuple[Diagnosis, ...]
    undiagnosed: tuple[str, ...]
    controllers: Controllers
    has_crashed: bool
    files: Mapping[str, bytes]

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The diagnosis of the first axis that has one."""
        return self.diagnoses[0] if self.diagnoses else None

    @property
    def passed(self) -> bool:
        """Whether the model applies to every axis and no controller failed."""
        return self.model.applies and self.controllers.passed and not self.has_crashed

    def save(self, folder: str | Path) -> None:
        """Write every file into a folder that is new, empty or of an earlier calibration.

        Raises ``OutputFolderError`` if a file was edited or was not written by piezoid.

        >>> done = piezoid.calibrate("sweep.csv")
        >>> done.save("stage")
        >>> piezoid.load("stage").applies
        True
        """
        add_to_folder(folder, self.files)


def calibrate(
    collection: Collection,
    lab: Lab | None,
    progress: Progress,
    *,
    threads: int = 1,
) -> Calibration:
    """Fit, diagnose, design, export and verify one stage, one axis after the other.

    threads  of diagnosis and verification; the results do not depend on them

    Raises what fitting raises. If no controller can be designed, the result has none, and the
    reason.
    """
    stage, jobs = jobs_of(collection, lab, threads, progress)
    results = [run_job(job, progress) for job in jobs]
    return finish(stage, results, lab, progress, threads)


def finish(
    stage: ActuatorModel,
    results: Sequence[JobResult],
    lab: Lab | None,
    progress: Progress,
    threads: int,
) -> Calibration:
    """Assemble a stage from its fitted and designed axes, export it and verify it.

    results  of the jobs; their models are added to those of the stage
    threads  of the verification; its result does not depend on them
    """
    models = {r.model.axis: r.model for r in results if r.model is not None}
    tips = [r.tunnelling for r in results if r.tunnelling is not None]
    tunnelling = tips[0] if tips else stage.tunnelling
    model = replace(stage, axes={**stage.axes, **models}, tunnelling=tunnelling)
    diagnoses = tuple(r.diagnosis for r in results if r.diagnosis is not None)
    axes_first = sorted(results, key=lambda result: result.model is None)
    files = {"model.json": write_model(model)}
    if diagnoses:
        files["diagnosis.json"] = write_diagnosis(diagnoses[0], further_axes=diagnoses[1:])
    if lab is not None and lab.digest:  # later verbs read what the laboratory declared
        files["lab.toml"] = (lab.folder / lab.place).read_bytes()
    controllers = controllers_of(
        model,
        files["model.json"],
        lab,
        progress,
        outcomes=[outcome for result in axes_first for outcome in result.outcomes],
        fault=next((r.fault for r in axes_first if r.fault is not None), None),
        threads=threads,
    )
    return Calibration(
        model=model,
        diagnoses=diagnoses,
        undiagnosed=tuple(r.undiagnosed for r in results if r.undiagnosed),
        controllers=controllers,
        has_crashed=controllers.has_crashed or any(r.has_crashed for r in results),
        files=files | controllers.files,
    )
