"""Names of the targets of `piezoid export`, and the files of each."""

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from piezoid.design.design import Design
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.lab import Lab
from piezoid.targets.fmu import controller_units, fmu_files, plant_units
from piezoid.targets.library import shared_library_files
from piezoid.targets.nanonis import nanonis_files
from piezoid.targets.pid import pid_files
from piezoid.targets.target_inputs import ControllerHardware, TargetInputs
from piezoid.targets.waveform import waveform_files
from piezoid.verification.verify_stage import stage_plants

BUNDLE = "bundle"
RENAMED = {"pi-pid": "pid", "biquad": "pid"}

FilesAndNotes = tuple[Mapping[str, bytes], tuple[str, ...]]

# The name of a target is also that of its folder.
_WRITERS: dict[str, Callable[[TargetInputs], FilesAndNotes]] = {
    "fmu": lambda inputs: fmu_files(
        {**controller_units(inputs.file), **plant_units(inputs.file.name, inputs.plants)}
    ),
    "library": lambda inputs: shared_library_files(inputs.file),
    "pid": pid_files,
    "nanonis": nanonis_files,
    "waveform": waveform_files,
}
TARGETS = (BUNDLE, *_WRITERS)
FOLDERS = (*TARGETS, *RENAMED)  # of this version and of earlier ones


def check_targets(names: Iterable[str]) -> tuple[str, ...]:
    """Return the requested targets, each once; refuse an unknown name with ``ParameterFileError``.

    >>> check_targets(["pid", "fmu", "pid"])
    ('pid', 'fmu')
    """
    requested = tuple(dict.fromkeys(names))
    for name in requested:
        if name in RENAMED:
            raise ParameterFileError(
                f"target {name!r} was replaced by {RENAMED[name]!r}",
                needed=f"one of {', '.join(TARGETS)}",
                remedy=f"Use --target {RENAMED[name]}, and table [{RENAMED[name]}] in box.toml.",
            )
        if name not in TARGETS:
            raise ParameterFileError(
                f"there is no target {name!r}",
                needed=f"one of {', '.join(TARGETS)}",
                remedy="Use one of these after --target, or none: the bundle is always written.",
            )
    return requested


def inputs_of(
    file: ParameterFile,
    model: ActuatorModel,
    design: Design,
    lab: Lab | None = None,
    *,
    hardware: ControllerHardware | None = None,
) -> TargetInputs:
    """Return the inputs of the targets: exported parameters with the plants of their stage.

    design    from which the file was exported
    hardware  limits of the hardware for which targets are made; None: the defaults
    """
    declared = lab or Lab()
    plants, variations = stage_plants(file, model, declared)
    axes = [plant.axis for plant in plants]
    gains = {axis.axis: declared.amplifier_of(axis.axis).gain_V_per_V for axis in file.axes}
    return TargetInputs(
        file=file,
        plants=plants,
        drawn=dict(zip(axes, variations, strict=True)),
        models={axis.axis: model[axis.axis] for axis in file.axes if not axis.is_tip},
        designs={axis.axis: axis for axis in design.axes},
        converter_V=declared.acquisition.input_range_V,
        amplifier_V_per_V={axis: gain for axis, gain in gains.items() if gain is not None},
        hardware=hardware or ControllerHardware(),
    )


def target_files(inputs: TargetInputs, targets: Iterable[str]) -> FilesAndNotes:
    """Return the files of all targets but the bundle; the same input gives the same bytes.

    returned  files by name below the stage folder, and notes for the user
    """
    files: dict[str, bytes] = {}
    notes: list[str] = []
    for target in targets:
        if target in _WRITERS:
            contents, target_notes = _WRITERS[target](inputs)
            files |= {f"{target}/{name}": content for name, content in contents.items()}
            notes.extend(target_notes)
    return MappingProxyType(files), tuple(notes)
