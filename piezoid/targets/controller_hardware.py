"""Limits of the hardware for which a target is made, from box.toml."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from piezoid.errors import ParameterFileError
from piezoid.toml_files import read_toml

SHAPES = ("triangle", "sine")
_MAX_POINTS = 2**24


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


@dataclass(frozen=True)
class _Key:
    """Description of the allowed values of a key, and conversion, which raises ``ValueError``."""

    needed: str
    convert: Callable[[Any], Any]


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        raise ValueError
    return float(value)


def _positive(value: Any) -> float:
    if not _number(value) > 0.0:
        raise ValueError
    return float(value)


def _integer(lowest: int, highest: int) -> _Key:
    def convert(value: Any) -> int:
        if not isinstance(value, int) or not lowest <= _number(value) <= highest:
            raise ValueError
        return value

    return _Key(f"a whole number from {lowest} to {highest}", convert)


def _shape(value: Any) -> str:
    return SHAPES[SHAPES.index(value)]


def _range(value: Any) -> tuple[float, float]:
    low, high = map(_number, value if isinstance(value, list) else ())
    if not low < high:
        raise ValueError
    return low, high


_POSITIVE = _Key("a number above 0", _positive)
_TABLES: Mapping[str, Mapping[str, _Key]] = {
    "pid": {"notches": _integer(0, 2), "slew_V_per_s": _POSITIVE, "update_Hz": _POSITIVE},
    "nanonis": {
        "table_points": _integer(3, 1024),
        "drift_limit_percent": _POSITIVE,
        "frame_half_range_m": _POSITIVE,
    },
    "waveform": {
        "shape": _Key(" or ".join(SHAPES), _shape),
        "frequency_Hz": _POSITIVE,
        "half_range_m": _POSITIVE,
        "rate_Hz": _POSITIVE,
        "points": _integer(4, _MAX_POINTS),
        "bits": _integer(8, 16),
        "range_V": _Key("two voltages, the lower first", _range),
    },
}


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
            spec = _TABLES[name].get(key)
            if spec is None:
                keys = ", ".join(_TABLES[name])
                raise _unusable(path, f"{key} is no key of [{name}]", f"one of {keys}")
            try:
                values[key] = spec.convert(value)
            except ValueError:
                fault = f"{key} of [{name}] is {value!r}"
                raise _unusable(path, fault, spec.needed) from None
    return ControllerHardware(**values)


def _unusable(path: Path, fault: str, needed: str) -> ParameterFileError:
    return ParameterFileError(
        f"{path}: {fault}", needed=needed, remedy="Correct it, and export again."
    )
