"""From recordings to every sealed file of a stage's folder; what is drawn is added upstairs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from piezoid.calibration.controllers import Controllers, controllers_of, files_of
from piezoid.calibration.stage_jobs import AxisResult, Designed, TipResult, jobs_of, run_job
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
    """One stage, from its recordings to the verdict on what ships.

    diagnoses    of every axis that could be diagnosed, the first one in front
    undiagnosed  why the others could not, a sentence each
    controllers  what was designed and ships, or why nothing does
    stumbled     a fault of ours ended a diagnosis or the way to the controller; the reasons say
                 which
    files        name and bytes of everything that belongs into the folder
    """

    model: ActuatorModel
    diagnoses: tuple[Diagnosis, ...]
    undiagnosed: tuple[str, ...]
    controllers: Controllers
    stumbled: bool
    files: Mapping[str, bytes]

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The diagnosis of the first axis that has one."""
        return self.diagnoses[0] if self.diagnoses else None

    @property
    def passed(self) -> bool:
        """Whether the model applies to every axis, and nothing about the controllers failed."""
        return self.model.applies and self.controllers.passed and not self.stumbled

    def save(self, folder: str | Path) -> None:
        """Write every file into a folder that is new, empty or of an earlier calibration.

        Raises ``OutputFolderError`` where a file was edited or is not one that piezoid wrote.

        >>> done = piezoid.calibrate("sweep.csv")
        >>> done.save("stage")
        >>> piezoid.load("stage").applies
        True
        """
        add_to_folder(folder, self.files)


@dataclass(frozen=True, kw_only=True)
class FittedStage:
    """What was found of all axes.

    designed  what came of designing them, in their order, a tip behind; None: not tried yet
    """

    model: ActuatorModel
    diagnoses: tuple[Diagnosis, ...] = ()
    undiagnosed: tuple[str, ...] = ()
    stumbled: bool = False
    designed: tuple[Designed, ...] | None = None


def calibrate(
    collection: Collection,
    lab: Lab | None,
    progress: Progress = lambda _: None,
    *,
    threads: int = 1,
) -> Calibration:
    """Fit, diagnose, design, export and verify one stage, one axis after the other.

    threads  so many diagnose and verify; what they find does not depend on it

    Raises what fitting raises; a stage for which no controller can be designed is a calibration
    without one.
    """
    blank, jobs = jobs_of(collection, lab, threads, progress)
    return finished(
        stage_of(blank, [run_job(job, progress) for job in jobs]), lab, progress, threads
    )


def stage_of(blank: ActuatorModel, results: Sequence[AxisResult | TipResult]) -> FittedStage:
    """Put together what came of the jobs of a stage.

    blank  the stage before any fit
    """
    axes = [result for result in results if isinstance(result, AxisResult)]
    tips = [result for result in results if isinstance(result, TipResult)]
    return FittedStage(
        model=replace(
            blank,
            axes={result.model.axis: result.model for result in axes},
            tunnelling=tips[0].tunnelling if tips else None,
        ),
        diagnoses=tuple(result.diagnosis for result in axes if result.diagnosis is not None),
        undiagnosed=tuple(result.undiagnosed for result in axes if result.undiagnosed),
        stumbled=any(result.stumbled for result in axes),
        designed=(*(result.designed for result in axes), *(result.designed for result in tips)),
    )


def finished(
    stage: FittedStage, lab: Lab | None, progress: Progress, threads: int = 1
) -> Calibration:
    """Design, export and verify a stage that is fitted.

    threads  so many verify; the files are the same bytes
    """
    model_file = write_model(stage.model)
    files = {"model.json": model_file}
    if stage.diagnoses:
        files["diagnosis.json"] = write_diagnosis(stage.diagnoses[0], others=stage.diagnoses[1:])
    if lab is not None and lab.digest:  # later verbs read what the laboratory declared
        files["lab.toml"] = (lab.folder / lab.place).read_bytes()
    controllers = controllers_of(
        stage.model,
        model_file,
        lab,
        progress,
        designed=stage.designed,
        threads=threads,
    )
    return Calibration(
        model=stage.model,
        diagnoses=stage.diagnoses,
        undiagnosed=stage.undiagnosed,
        controllers=controllers,
        stumbled=stage.stumbled or controllers.stumbled,
        files=files | files_of(controllers),
    )
