"""Inputs of the targets, and the comparison of a target with the exported controller.

The limits of the hardware for which a target is made come from box.toml.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from piezoid.design.design import AxisDesign
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.toml_files import read_toml
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import AxisPlant

SEED = 0  # of the sensor noise in every comparison

_MAX_POINTS = 2**24
_Positive = Annotated[float, msgspec.Meta(gt=0.0, lt=1e12)]
_Voltage = Annotated[float, msgspec.Meta(gt=-1e12, lt=1e12)]

Errors = Mapping[str, Mapping[str, float]]
"""Errors in m by plant and by column of the table in README.md."""


class ControllerHardware(msgspec.Struct, frozen=True, kw_only=True):
    """Limits of the hardware: the keys of box.toml; None stands for the value of the stage.

    notches              of a PID controller, 0 to 2
    slew_V_per_s         slew limit of a PID controller; None: that of the amplifier
    update_Hz            rate of second-order sections; None: the controller's rate
    table_points         of a hysteresis table
    drift_limit_percent  of the range, for drift compensation
    frame_half_range_m   of a frame; None: 0.7 of the largest half range
    shape                of the scan, ``triangle`` (rounded corners) or ``sine``
    frequency_Hz         of the lines to and fro
    half_range_m         of the scan; None: 0.7 of the largest half range
    rate_Hz              of the points of a waveform; None: the controller's rate
    points               size of the waveform memory
    bits, range_V        of the converter of the wave generator
    """

    notches: Annotated[int, msgspec.Meta(ge=0, le=2)] = 2
    slew_V_per_s: _Positive | None = None
    update_Hz: _Positive | None = None
    table_points: Annotated[int, msgspec.Meta(ge=3, le=1024)] = 32
    drift_limit_percent: _Positive = 10.0
    frame_half_range_m: _Positive | None = None
    shape: Annotated[str, msgspec.Meta(pattern="^(triangle|sine)$")] = "triangle"
    frequency_Hz: _Positive = 10.0
    half_range_m: _Positive | None = None
    rate_Hz: _Positive | None = None
    points: Annotated[int, msgspec.Meta(ge=4, le=_MAX_POINTS)] = _MAX_POINTS
    bits: Annotated[int, msgspec.Meta(ge=8, le=16)] = 16
    range_V: tuple[_Voltage, _Voltage] | None = None

    def __post_init__(self) -> None:
        if self.range_V is not None and not self.range_V[0] < self.range_V[1]:
            raise ValueError("two voltages, the lower first")


_KEYS = {
    "pid": ("notches", "slew_V_per_s", "update_Hz"),
    "nanonis": ("table_points", "drift_limit_percent", "frame_half_range_m"),
    "waveform": (
        *("shape", "frequency_Hz", "half_range_m", "rate_Hz", "points", "bits", "range_V"),
    ),
}


def read_hardware(path: Path) -> ControllerHardware:
    """Read box.toml.

    Raises ``ParameterFileError`` with the key and its allowed values.
    """
    names = ", ".join(f"[{name}]" for name in _KEYS)
    try:
        tables = read_toml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ParameterFileError(
            f"{path} cannot be read: {error}",
            needed=f"a TOML file with tables of {names}",
            remedy="Correct the file, or leave --box out to use the defaults of the guide.",
        ) from None
    values: dict[str, Any] = {}
    for name, table in tables.items():
        if name not in _KEYS or not isinstance(table, Mapping):
            raise _unusable(path, f"[{name}] is no table of box.toml", f"one of {names}")
        for key, value in table.items():
            if key not in _KEYS[name]:
                keys = ", ".join(_KEYS[name])
                raise _unusable(path, f"{key} is no key of [{name}]", f"one of {keys}")
            try:
                checked = msgspec.convert({key: value}, ControllerHardware)
            except msgspec.ValidationError as error:
                needed = str(error).partition(" - at")[0].removeprefix("Expected ")
                raise _unusable(path, f"{key} of [{name}] is {value!r}", needed) from None
            values[key] = getattr(checked, key)
    return ControllerHardware(**values)


def _unusable(path: Path, fault: str, needed: str) -> ParameterFileError:
    return ParameterFileError(
        f"{path}: {fault}", needed=needed, remedy="Correct it, and export again."
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetInputs:
    """Exported controller, identified plants and hardware limits.

    file         exported parameters
    plants       identified plants of the axes, as in verification
    drawn        other plants that the recordings allow, by axis
    models       identified models, by axis
    designs      designed loops, by axis
    converter_V  range of the stage's converter; None: not declared in lab.toml
    amplifier_V_per_V  gains that lab.toml declares, by axis
    hardware     limits of the hardware for which targets are made
    """

    file: ParameterFile
    plants: Sequence[AxisPlant] = ()
    drawn: Mapping[str, Sequence[AxisPlant]] = field(default_factory=dict)
    models: Mapping[str, AxisModel] = field(default_factory=dict)
    designs: Mapping[str, AxisDesign] = field(default_factory=dict)
    converter_V: tuple[float, float] | None = None
    amplifier_V_per_V: Mapping[str, float] = field(default_factory=dict)
    hardware: ControllerHardware = field(default_factory=ControllerHardware)

    @property
    def lateral(self) -> tuple[AxisParameters, ...]:
        """Axes that control a displacement and have an identified model."""
        return tuple(axis for axis in self.file.axes if axis.axis in self.models)

    @property
    def tips(self) -> tuple[str, ...]:
        """Names of the axes that regulate a current."""
        return tuple(axis.axis for axis in self.file.axes if axis.is_tip)

    def family(self, axis: str) -> tuple[AxisPlant, ...]:
        """Return the identified plant of an axis, then other plants that the recordings allow."""
        identified = next(plant for plant in self.plants if plant.axis == axis)
        return (identified, *self.drawn.get(axis, ()))


def exported_position_m(axis: AxisParameters, plant: AxisPlant, path_m: Array) -> Array:
    """Simulate the exported controller along a path; return the position, (samples,)."""
    rng = np.random.default_rng(SEED)
    return run_axis(plant, axis, path_m, rng=rng, has_approach=True).position


def worst_errors(errors_m: Errors) -> dict[str, str]:
    """Return the largest error of each column, formatted."""
    columns = next(iter(errors_m.values()))
    return {name: with_unit(max(row[name] for row in errors_m.values()), "m") for name in columns}


def error_rows(errors_m: Errors) -> str:
    """Return the rows of a Markdown table: a plant and its errors."""
    return "\n".join(
        f"| {plant} | {' | '.join(with_unit(error_m, 'm') for error_m in row.values())} |"
        for plant, row in errors_m.items()
    )
