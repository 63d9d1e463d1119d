"""The whole way of one stage: recordings in, every file of its folder out, nothing printed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.identification.model import ActuatorModel
    from piezoid.records.lab import Lab
    from piezoid.records.recording import Recording
    from piezoid_cli.controllers import Controllers

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


@dataclass(frozen=True, kw_only=True)
class _Diagnosed:
    found: "tuple[Diagnosis, ...]"
    missing: tuple[str, ...]
    stumbled: bool


def calibrate(files: Sequence[Path], lab: Path | None, told: Told) -> Calibration:
    """Fit, diagnose, design, export, verify and report one stage.

    Raises what reading and fitting raise; a stage for which no controller can be designed is a
    calibration without one.
    """
    told("reading recordings")
    from piezoid.identification.fit import fit
    from piezoid.identification.store import write_model
    from piezoid.records.collection import collect
    from piezoid.records.lab import read_lab
    from piezoid_cli.controllers import controllers_of, files_of
    from piezoid_reports.render import render

    declared = None if lab is None else read_lab(lab)
    held = collect(files, declared)
    model = fit(held.recordings, lab=declared, sweeps=held.sweeps, progress=told)
    diagnosed = _diagnosed(held.recordings, declared, model, told)
    diagnoses = diagnosed.found
    model = _extended(model, diagnoses)
    content = {"model.json": write_model(model), **_told_files(diagnoses, lab)}
    made = controllers_of(model, content["model.json"], declared, told)
    content |= files_of(made)
    told("writing the report")
    page = render(
        model,
        held.recordings,
        held.sweeps,
        made.design,
        made.reason,
        diagnoses=diagnoses,
        undiagnosed=diagnosed.missing,
        verification=made.verification,
        unshipped=made.unshipped,
        files=content,
        lab=declared,
    )
    return Calibration(
        model=model,
        diagnoses=diagnoses,
        undiagnosed=diagnosed.missing,
        controllers=made,
        stumbled=diagnosed.stumbled or made.stumbled,
        files={**content, "report.html": page.encode()},
    )


def _told_files(diagnoses: "Sequence[Diagnosis]", lab: Path | None) -> dict[str, bytes]:
    """Return what was diagnosed, and what the laboratory said: later verbs ask for it again."""
    from piezoid.diagnosis.diagnosis import write_diagnosis

    files = {}
    if diagnoses:
        files["diagnosis.json"] = write_diagnosis(diagnoses[0], others=diagnoses[1:])
    if lab is not None:
        files["lab.toml"] = lab.read_bytes()
    return files


def _diagnosed(
    recordings: "Sequence[Recording]", lab: "Lab | None", model: "ActuatorModel", told: Told
) -> _Diagnosed:
    """Return the diagnoses of all axes, and why there is none where one failed.

    Whatever a diagnosis stumbles over, model and report are there without it.
    """
    from piezoid.diagnosis.diagnose import diagnose
    from piezoid.errors import PiezoidError

    found, missing, stumbled = [], [], False
    for axis, known in model.axes.items():
        try:
            found.append(diagnose(recordings, axis=axis, lab=lab, model=known, progress=told))
        except PiezoidError as refusal:
            missing.append(f"axis {axis} is not diagnosed: {refusal}")
        except Exception as error:  # a fault of ours must not cost the lab its model
            fault = f"a mistake of ours, {type(error).__name__}: {error}"
            missing.append(f"axis {axis} is not diagnosed: {fault}")
            stumbled = True
    return _Diagnosed(found=tuple(found), missing=tuple(missing), stumbled=stumbled)


def _extended(model: "ActuatorModel", diagnoses: "Sequence[Diagnosis]") -> "ActuatorModel":
    """Return the stage with everything in its axes that their diagnoses found."""
    from dataclasses import replace

    found = {one.axis: one.model for one in diagnoses if one.model is not None}
    return replace(model, axes={axis: found.get(axis, one) for axis, one in model.axes.items()})
