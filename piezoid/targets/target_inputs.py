"""Inputs of the targets, and the comparison of a target with the exported controller.

The limits of the hardware for which a target is made come from box.toml.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from piezoid.design.design import AxisDesign
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.toml_files import read_toml
from piezoid.verification.closed_loop import approach_path, run_axis
from piezoid.verification.plant import AxisPlant

SEED = 0  # of the sensor noise in every comparison

SHAPES = ("triangle", "sine")
_MAX_POINTS = 2**24
_LARGEST = 1e12  # number in box.toml

Errors = Mapping[str, Mapping[str, float]]
"""Errors in m by plant and by column of the table in README.md."""


@dataclass(frozen=True, kw_only=True)
class ControllerHardware:
    """Limits of the hardware; None stands for the value of the stage.

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

    notches: int = 2
    slew_V_per_s: float | None = None
    update_Hz: float | None = None
    table_points: int = 32
    drift_limit_percent: float = 10.0
    frame_half_range_m: float | None = None
    shape: str = "triangle"
    frequency_Hz: float = 10.0
    half_range_m: float | None = None
    rate_Hz: float | None = None
    points: int = _MAX_POINTS
    bits: int = 16
    range_V: tuple[float, float] | None = None


_POSITIVE, _SHAPE = "a number above 0", " or ".join(SHAPES)
_RANGE = "two voltages, the lower first"
# Allowed values by table and key: one of the rules above, or the ends of whole numbers.
_TABLES: Mapping[str, Mapping[str, str | tuple[int, int]]] = {
    "pid": {"notches": (0, 2), "slew_V_per_s": _POSITIVE, "update_Hz": _POSITIVE},
    "nanonis": {
        "table_points": (3, 1024),
        "drift_limit_percent": _POSITIVE,
        "frame_half_range_m": _POSITIVE,
    },
    "waveform": {
        "shape": _SHAPE,
        "frequency_Hz": _POSITIVE,
        "half_range_m": _POSITIVE,
        "rate_Hz": _POSITIVE,
        "points": (4, _MAX_POINTS),
        "bits": (8, 16),
        "range_V": _RANGE,
    },
}


def _converted(value: Any, rule: str | tuple[int, int]) -> Any:
    """Return a value for ``ControllerHardware``; raise ``ValueError`` if the rule excludes it."""
    if rule == _SHAPE:
        return SHAPES[SHAPES.index(value)]
    numbers = value if rule == _RANGE and isinstance(value, list) else [value]
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise ValueError
    if not all(abs(number) < _LARGEST for number in numbers):
        raise ValueError
    if not isinstance(rule, str):
        if not isinstance(value, int) or not rule[0] <= value <= rule[1]:
            raise ValueError
        return value
    low, high = map(float, numbers if rule == _RANGE else (0.0, value))
    if not low < high:
        raise ValueError
    return (low, high) if rule == _RANGE else high


def read_hardware(path: Path) -> ControllerHardware:
    """Read box.toml.

    Raises ``ParameterFileError`` with the key and its allowed values.
    """
    names = ", ".join(f"[{name}]" for name in _TABLES)
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
        if name not in _TABLES or not isinstance(table, Mapping):
            raise _unusable(path, f"[{name}] is no table of box.toml", f"one of {names}")
        for key, value in table.items():
            rule = _TABLES[name].get(key)
            if rule is None:
                keys = ", ".join(_TABLES[name])
                raise _unusable(path, f"{key} is no key of [{name}]", f"one of {keys}")
            try:
                values[key] = _converted(value, rule)
            except ValueError:
                fault = f"{key} of [{name}] is {value!r}"
                if not isinstance(rule, str):
                    rule = f"a whole number from {rule[0]} to {rule[1]}"
                raise _unusable(path, fault, rule) from None
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
        return tuple(axis.axis for axis in self.file.axes if axis.method == "rst")

    def family(self, axis: str) -> tuple[AxisPlant, ...]:
        """Return the identified plant of an axis, then other plants that the recordings allow."""
        identified = next(plant for plant in self.plants if plant.axis == axis)
        return (identified, *self.drawn.get(axis, ()))


def exported_position_m(axis: AxisParameters, plant: AxisPlant, path_m: Array) -> Array:
    """Simulate the exported controller along a path; return the position, (samples,)."""
    approach_m = approach_path(plant, float(path_m[0]))
    reference_m = np.concatenate([approach_m, path_m])
    record = run_axis(plant, axis, reference_m, rng=np.random.default_rng(SEED))
    return record.position[len(approach_m) :]


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
