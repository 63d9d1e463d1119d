"""The whole way of one stage: recordings in, every file of its folder out, nothing printed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.identification.model import ActuatorModel
    from piezoid.records.collection import Collection
    from piezoid.records.lab import Lab
    from piezoid_cli.controllers import Controllers
    from piezoid_cli.stage_jobs import AxisFound, Designed, TipFound

Told = Callable[[str], None]


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

    model: "ActuatorModel"
    diagnoses: "tuple[Diagnosis, ...]"
    undiagnosed: tuple[str, ...]
    controllers: "Controllers"
    stumbled: bool
    files: Mapping[str, bytes]

    @property
    def diagnosis(self) -> "Diagnosis | None":
        """The diagnosis of the first axis that has one."""
        return self.diagnoses[0] if self.diagnoses else None

    @property
    def passed(self) -> bool:
        """Whether the model applies to every axis, and nothing about the controllers failed."""
        return self.model.applies and self.controllers.passed and not self.stumbled


def calibrate(
    files: Sequence[Path], lab: Path | None, told: Told, processes: int = 1
) -> Calibration:
    """Fit, diagnose, design, export, verify and report one stage.

    processes  at most so many do the axes, this one among them; the files are the same bytes

    Raises what reading and fitting raise; a stage for which no controller can be designed is a
    calibration without one.
    """
    told("reading recordings")
    from piezoid_cli.aside import with_trials_aside
    from piezoid_cli.other_process import others
    from piezoid_cli.side_by_side import side_by_side
    from piezoid_cli.stage_jobs import jobs_of, ready, run_job, weight_of

    # One more begins to load before it is known what there is to do: a single file is one axis.
    with others(int(processes > 1 and len(files) > 1), ready) as begun:
        from piezoid.records.collection import collect
        from piezoid.records.lab import read_lab

        declared = None if lab is None else read_lab(lab)
        held = collect(files, declared)
        blank, ways = jobs_of(held, declared, processes)
        jobs = with_trials_aside(ways, begun)
        found = side_by_side(
            run_job, jobs, told, processes=processes, weight=weight_of, begun=begun
        )
    return finished(_stage(blank, found), held, lab, declared, told, processes)


@dataclass(frozen=True, kw_only=True)
class FittedStage:
    """What was found of all axes.

    designed  what came of designing them, in their order, a tip behind; None: not tried yet
    """

    model: "ActuatorModel"
    diagnoses: "tuple[Diagnosis, ...]" = ()
    undiagnosed: tuple[str, ...] = ()
    stumbled: bool = False
    designed: "tuple[Designed, ...] | None" = None


def finished(
    stage: FittedStage,
    held: "Collection | None",
    lab: Path | None,
    declared: "Lab | None",
    told: Told,
    threads: int = 1,
) -> Calibration:
    """Design, export, verify and report a stage that is fitted.

    held      the recordings, for the report's pictures; None where they are larger than memory
    declared  what stands in ``lab``
    threads   so many verify; the files are the same bytes
    """
    from piezoid.identification.store import write_model
    from piezoid_cli.controllers import controllers_of, files_of
    from piezoid_reports.render import render

    content = {"model.json": write_model(stage.model), **_told_files(stage.diagnoses, lab)}
    made = controllers_of(
        stage.model,
        content["model.json"],
        declared,
        told,
        designed=stage.designed,
        threads=threads,
    )
    content |= files_of(made)
    told("writing the report")
    page = render(
        stage.model,
        () if held is None else held.recordings,
        () if held is None else held.sweeps,
        made.design,
        made.reason,
        responses=() if held is None else held.responses,
        diagnoses=stage.diagnoses,
        undiagnosed=stage.undiagnosed,
        verification=made.verification,
        unshipped=made.unshipped,
        files=content,
        lab=declared,
    )
    return Calibration(
        model=stage.model,
        diagnoses=stage.diagnoses,
        undiagnosed=stage.undiagnosed,
        controllers=made,
        stumbled=stage.stumbled or made.stumbled,
        files={**content, "report.html": page.encode()},
    )


def _stage(blank: "ActuatorModel", found: "Sequence[AxisFound | TipFound]") -> FittedStage:
    from piezoid_cli.stage_jobs import AxisFound, TipFound

    axes = [one for one in found if isinstance(one, AxisFound)]
    tips = [one for one in found if isinstance(one, TipFound)]
    return FittedStage(
        model=replace(
            blank,
            axes={one.model.axis: one.model for one in axes},
            tunnelling=tips[0].tunnelling if tips else None,
        ),
        diagnoses=tuple(one.diagnosis for one in axes if one.diagnosis is not None),
        undiagnosed=tuple(one.undiagnosed for one in axes if one.undiagnosed),
        stumbled=any(one.stumbled for one in axes),
        designed=(*(one.designed for one in axes), *(one.designed for one in tips)),
    )


def _told_files(diagnoses: "Sequence[Diagnosis]", lab: Path | None) -> dict[str, bytes]:
    """Return what was diagnosed, and what the laboratory said: later verbs ask for it again."""
    from piezoid.diagnosis.sealed_diagnosis import write_diagnosis

    files = {}
    if diagnoses:
        files["diagnosis.json"] = write_diagnosis(diagnoses[0], others=diagnoses[1:])
    if lab is not None:
        files["lab.toml"] = lab.read_bytes()
    return files
