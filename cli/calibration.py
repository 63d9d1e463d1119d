"""The whole way of one stage: recordings in, every file of its folder out, nothing printed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.design.design import Design
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.identification.model import ActuatorModel
    from piezoid.records.lab import Lab
    from piezoid.records.recording import Recording
    from piezoid.verification.verification import Verification

Told = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """One stage, from its recordings to the verdict on what ships.

    diagnoses     of every axis that could be diagnosed, the first one in front
    undiagnosed   why the others could not, a sentence each
    design        None where none could be made; ``undesigned`` then says why
    stumbled      a fault of ours ended a diagnosis or the way to the controller; the reasons say
                  which
    verification  of what ships; nothing ships without one
    files         name and bytes of everything that belongs into the folder
    """

    model: "ActuatorModel"
    diagnoses: "tuple[Diagnosis, ...]"
    undiagnosed: tuple[str, ...]
    design: "Design | None"
    undesigned: str
    stumbled: bool
    parameters: "ParameterFile | None"
    verification: "Verification | None"
    files: Mapping[str, bytes]

    @property
    def diagnosis(self) -> "Diagnosis | None":
        """The diagnosis of the first axis that has one."""
        return self.diagnoses[0] if self.diagnoses else None

    @property
    def passed(self) -> bool:
        """Whether the model applies to every axis, and nothing about the controller failed."""
        verified = self.verification is None or self.verification.passed
        return self.model.applies and verified and not self.stumbled


@dataclass(frozen=True, kw_only=True)
class _Diagnosed:
    found: "tuple[Diagnosis, ...]"
    missing: tuple[str, ...]
    stumbled: bool


@dataclass(frozen=True, kw_only=True)
class _Controller:
    design: "Design | None" = None
    parameters: "ParameterFile | None" = None
    verification: "Verification | None" = None
    reason: str = ""
    stumbled: bool = False


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
    from piezoid_reports.render import render

    declared = None if lab is None else read_lab(lab)
    held = collect(files, declared)
    model = fit(held.recordings, lab=declared, sweeps=held.sweeps, progress=told)
    diagnosed = _diagnosed(held.recordings, declared, model, told)
    diagnoses = diagnosed.found
    model = _extended(model, diagnoses)
    content = {"model.json": write_model(model), **_told_files(diagnoses, lab)}
    controller = _controller(model, content["model.json"], declared, told)
    content |= _files_of(controller)
    told("writing the report")
    page = render(
        model,
        held.recordings,
        held.sweeps,
        controller.design,
        controller.reason,
        diagnosis=diagnoses[0] if diagnoses else None,
        verification=controller.verification,
        files=content,
        lab=declared,
    )
    return Calibration(
        model=model,
        diagnoses=diagnoses,
        undiagnosed=diagnosed.missing,
        design=controller.design,
        undesigned=controller.reason,
        stumbled=diagnosed.stumbled or controller.stumbled,
        parameters=controller.parameters,
        verification=controller.verification,
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


def _controller(
    model: "ActuatorModel", content: bytes, lab: "Lab | None", told: Told
) -> _Controller:
    """Return the controllers and what became of them, or why there are none.

    Whatever stands in their way, model and report are there without them; a controller that could
    not be verified does not ship.
    """
    from piezoid.design.stage import design_stage
    from piezoid.errors import PiezoidError

    design = None
    try:
        digest = loads(content)["digest"]
        design = design_stage(model, model_digest=digest, lab=lab, progress=told)
        return _verified(model, design, lab, told)
    except PiezoidError as refusal:
        return _Controller(design=design, reason=str(refusal))
    except Exception as error:  # a fault of ours must not cost the lab its model
        reason = f"a mistake of ours, {type(error).__name__}: {error}"
        return _Controller(design=design, reason=reason, stumbled=True)


def _verified(
    model: "ActuatorModel", design: "Design", lab: "Lab | None", told: Told
) -> _Controller:
    """Return what ships of a design, and what its run against the stage showed."""
    from piezoid.export.stage import export_stage
    from piezoid.verification.stage import verify_stage

    told("exporting")
    design_digest = loads(design.to_json())["digest"]
    parameters = export_stage(model, design, design_digest=design_digest, lab=lab)
    told("running the compiled controller against the stage")
    found = verify_stage(parameters, model, lab=lab)
    return _Controller(design=design, parameters=parameters, verification=found)


def _files_of(controller: _Controller) -> dict[str, bytes]:
    from piezoid.export.bundle import bundle
    from piezoid.export.parameter_file import to_json

    files = {}
    if controller.design is not None:
        files["design.json"] = controller.design.to_json()
    if controller.parameters is not None:
        files["params.json"] = to_json(controller.parameters)
        held = bundle(controller.parameters).files
        files |= {f"bundle/{name}": text for name, text in held.items()}
    if controller.verification is not None:
        files["verification.json"] = controller.verification.to_json()
    return files
