"""Units of a frequency response as instruments write them: m/V, dB re 1 um/V, deg, rad/s."""

import re
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from piezoid.records.table import Column
from piezoid.records.units import BRACKETS, Dimension, unit_of


class Kind(Enum):
    """Quantity of a unit: SHARE is a ratio, DECIBEL a gain with an unknown reference."""

    FREQUENCY = auto()
    ANGLE = auto()
    GAIN = auto()  # displacement per volt
    VOLTAGE_GAIN = auto()  # volts of a sensor per volt
    LENGTH = auto()
    VOLTAGE = auto()
    DECIBEL = auto()
    SHARE = auto()


AMPLITUDES = frozenset({Kind.GAIN, Kind.VOLTAGE_GAIN, Kind.LENGTH, Kind.VOLTAGE})


@dataclass(frozen=True, kw_only=True)
class ResponseUnit:
    """One unit: ``SI = factor * value``, of decibels ``SI = factor * 10^(value / 20)``.

    factor  to Hz, rad, m/V, V/V, m, V or 1
    """

    symbol: str
    kind: Kind
    factor: float = 1.0
    is_decibel: bool = False


_RAD_PER_deg = np.pi / 180.0
_ANGLES = {
    **dict.fromkeys(("deg", "degree", "degrees", "°", "grad °"), _RAD_PER_deg),
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    "mrad": 1e-3,
}
_ANGULAR_FREQUENCIES = {
    **dict.fromkeys(("rad/s", "rad/sec", "rad s^-1", "rad_s", "rad_per_s"), 1.0),
    "krad/s": 1e3,
}
_KINDS = {
    Dimension.FREQUENCY: Kind.FREQUENCY,
    Dimension.LENGTH: Kind.LENGTH,
    Dimension.VOLTAGE: Kind.VOLTAGE,
    Dimension.RATIO: Kind.SHARE,
}
_PER_VOLT = {Dimension.LENGTH: Kind.GAIN, Dimension.VOLTAGE: Kind.VOLTAGE_GAIN}
_RATIO = re.compile(r"([A-Za-zµμÅ]+)\s?(?:/|_per_| per )\s?([A-Za-zµμ]+)")
_DECIBEL = re.compile(r"dB\s*(?:re\.?|of|rel\.?)?\s*[(\[]?\s*1?\s*(.*?)\s*[)\]]?", re.IGNORECASE)
_PART = re.compile(r"^(?:real|imag)\((.*)\)$")
_INDEX = re.compile(r"\(\d,\d\)$")
# A unit at the end of a name: ``phase_deg``, ``gain, um/V``, ``mag um_per_V``, ``freq/Hz``.
_UNITS_AT_END = (
    re.compile(r".*[\s,;_](rad_s|rad_per_s|[A-Za-zµμ]+_per_[A-Za-z]+)$"),
    re.compile(r".*[\s,;]([A-Za-zµμ°]+/[A-Za-zµμ]+)$"),
    re.compile(r".*[\s,;_/]([A-Za-zµμ°%]+)$"),
)


def response_unit(text: str) -> ResponseUnit | None:
    """Return the unit that a text names; None if it is not a unit of a frequency response."""
    symbol = " ".join(text.split())
    name = symbol.lower()
    if name in _ANGLES:
        return ResponseUnit(symbol=symbol, kind=Kind.ANGLE, factor=_ANGLES[name])
    if name in _ANGULAR_FREQUENCIES:
        factor = _ANGULAR_FREQUENCIES[name] / (2.0 * np.pi)
        return ResponseUnit(symbol=symbol, kind=Kind.FREQUENCY, factor=factor)
    if name.startswith("db") and (match := _DECIBEL.fullmatch(symbol)):
        if not match[1]:
            return ResponseUnit(symbol=symbol, kind=Kind.DECIBEL, is_decibel=True)
        reference = response_unit(match[1])
        if reference is None or reference.is_decibel or reference.kind not in AMPLITUDES:
            return None
        return replace(reference, symbol=symbol, is_decibel=True)
    if match := _RATIO.fullmatch(symbol):
        numerator, denominator = map(unit_of, match.groups())
        if numerator is None or denominator is None or numerator.dimension not in _PER_VOLT:
            return None
        if denominator.dimension is not Dimension.VOLTAGE:
            return None
        factor = numerator.factor / denominator.factor
        return ResponseUnit(symbol=symbol, kind=_PER_VOLT[numerator.dimension], factor=factor)
    unit = unit_of(symbol)
    if unit is None or unit.dimension not in _KINDS:
        return None
    return ResponseUnit(symbol=symbol, kind=_KINDS[unit.dimension], factor=unit.factor)


def base_name(label: str) -> str:
    """Return a name without the additions of readers: ``real(H(1,2))`` is ``H``."""
    return _INDEX.sub("", _PART.sub(r"\1", label))


def unit_in_heading(column: Column) -> ResponseUnit | None:
    """Return the unit of a column that the format or its heading states, else None."""
    stated = [column.declared_unit] if column.declared_unit.strip() else []
    label = base_name(" ".join(column.label.split()))
    # Units from a row of units lack the outer brackets: ``(dB (um/V))`` becomes ``dB (um/V``.
    stated += [text + ")" for text in stated if text.count("(") > text.count(")")]
    stated += [a or b for a, b in reversed(BRACKETS.findall(label))]
    stated += [match.group(1) for end in _UNITS_AT_END if (match := end.match(label))]
    return next((unit for text in stated if (unit := response_unit(text)) is not None), None)
