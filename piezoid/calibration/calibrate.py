"""Calibrate a stage: from recordings to the sealed files of its folder, without the report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from piezoid.calibration.axis_jobs import JobResult, jobs_of, run_job
from piezoid.calibration.controllers import Controllers, controllers_of
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.store import write_model
from piezoid.output_folder import add_to_folder
from piezoid.records.collection import Collection
from piezoid.records.lab import Lab

Progress = Callable[[str], None]


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
    return finish(with_results(stage, results), results, lab, progress, threads)


def with_results(stage: ActuatorModel, results: Sequence[JobResult]) -> ActuatorModel:
    """Add the models of the axes and of the tip to a stage."""
    models = [result.model for result in results if result.model is not None]
    tips = [result.tunnelling for result in results if result.tunnelling is not None]
    return replace(
        stage,
        axes={model.axis: model for model in models},
        tunnelling=tips[0] if tips else None,
    )


def finish(
    model: ActuatorModel,
    results: Sequence[JobResult],
    lab: Lab | None,
    progress: Progress,
    threads: int,
) -> Calibration:
    """Export and verify a stage whose axes are fitted and designed.

    results  of the jobs: diagnoses and designs
    threads  of the verification; its result does not depend on them
    """
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
