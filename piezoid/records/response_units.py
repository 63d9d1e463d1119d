"""Units of a frequency response as instruments write them: m/V, dB re 1 um/V, deg, rad/s."""

import re
from dataclasses import dataclass
from enum import Enum

import numpy as np

from piezoid.records.table import Column
from piezoid.records.units import Dimension, unit_of


class Kind(Enum):
    """What a unit measures; the value is how messages call it."""

    FREQUENCY = "a frequency"
    ANGLE = "an angle"
    GAIN = "a displacement per volt"
    VOLTAGE_GAIN = "a sensor's volts per volt"
    LENGTH = "a displacement"
    VOLTAGE = "a voltage"
    DECIBEL = "decibels of an unknown unit"
    SHARE = "a share"


@dataclass(frozen=True, kw_only=True)
class ResponseUnit:
    """One unit: ``SI = factor * value``, of decibels ``SI = factor * 10^(value / 20)``.

    factor  to Hz, rad, m/V, V/V, m, V or 1
    """

    symbol: str
    kind: Kind
    factor: float = 1.0
    is_decibel: bool = False


_ANGLES = {
    "deg": np.pi / 180.0, "degree": np.pi / 180.0, "degrees": np.pi / 180.0, "°": np.pi / 180.0,
    "grad °": np.pi / 180.0, "rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3,
}  # fmt: skip
_TURNS = {"rad/s": 1.0, "rad/sec": 1.0, "rad s^-1": 1.0, "rad_s": 1.0, "rad_per_s": 1.0,
          "krad/s": 1e3}  # fmt: skip
_RATIO = re.compile(r"([A-Za-zµμÅ]+)\s?(?:/|_per_| per )\s?([A-Za-zµμ]+)")
_DECIBEL = re.compile(r"dB\s*(?:re\.?|of|rel\.?)?\s*[(\[]?\s*1?\s*(.*?)\s*[)\]]?", re.IGNORECASE)
_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)")
_PART = re.compile(r"^(?:real|imag)\((.*)\)$")
_INDEX = re.compile(r"\(\d,\d\)$")
# A unit at the end of a name: ``phase_deg``, ``gain, um/V``, ``mag um_per_V``, ``freq/Hz``.
_AT_THE_END = (
    re.compile(r".*[\s,;_](rad_s|rad_per_s|[A-Za-zµμ]+_per_[A-Za-z]+)$"),
    re.compile(r".*[\s,;]([A-Za-zµμ°]+/[A-Za-zµμ]+)$"),
    re.compile(r".*[\s,;_/]([A-Za-zµμ°%]+)$"),
)


def response_unit(text: str) -> ResponseUnit | None:
    """Return the unit a text stands for, None where it stands for none of a response."""
    symbol = " ".join(text.split())
    if symbol.lower() in _ANGLES:
        return ResponseUnit(symbol=symbol, kind=Kind.ANGLE, factor=_ANGLES[symbol.lower()])
    if symbol.lower() in _TURNS:
        factor = _TURNS[symbol.lower()] / (2.0 * np.pi)
        return ResponseUnit(symbol=symbol, kind=Kind.FREQUENCY, factor=factor)
    if symbol[:2].lower() == "db" and (match := _DECIBEL.fullmatch(symbol)):
        return _decibel(symbol, match.group(1))
    if match := _RATIO.fullmatch(symbol):
        return _ratio(symbol, *match.groups())
    found = unit_of(symbol)
    kind = None if found is None else _PLAIN.get(found.dimension)
    if found is None or kind is None:
        return None
    return ResponseUnit(symbol=symbol, kind=kind, factor=found.factor)


_PLAIN = {
    Dimension.FREQUENCY: Kind.FREQUENCY,
    Dimension.LENGTH: Kind.LENGTH,
    Dimension.VOLTAGE: Kind.VOLTAGE,
    Dimension.RATIO: Kind.SHARE,
}


def _decibel(symbol: str, reference: str) -> ResponseUnit | None:
    if not reference:
        return ResponseUnit(symbol=symbol, kind=Kind.DECIBEL, is_decibel=True)
    inner = response_unit(reference)
    if inner is None or inner.is_decibel or inner.kind not in _OF_RESPONSES:
        return None
    return ResponseUnit(symbol=symbol, kind=inner.kind, factor=inner.factor, is_decibel=True)


_OF_RESPONSES = (Kind.GAIN, Kind.VOLTAGE_GAIN, Kind.LENGTH, Kind.VOLTAGE)


def _ratio(symbol: str, above: str, below: str) -> ResponseUnit | None:
    top, bottom = unit_of(above), unit_of(below)
    if top is None or bottom is None or bottom.dimension is not Dimension.VOLTAGE:
        return None
    kinds = {Dimension.LENGTH: Kind.GAIN, Dimension.VOLTAGE: Kind.VOLTAGE_GAIN}
    if top.dimension not in kinds:
        return None
    return ResponseUnit(
        symbol=symbol, kind=kinds[top.dimension], factor=top.factor / bottom.factor
    )


def bare(label: str) -> str:
    """Return a name without what our readers put about it: ``real(H(1,2))`` is ``H``."""
    return _INDEX.sub("", _PART.sub(r"\1", label))


def unit_in_heading(column: Column) -> ResponseUnit | None:
    """Return the unit of a column by what the format or its heading states, else None."""
    stated = [column.declared_unit] if column.declared_unit.strip() else []
    label = bare(" ".join(column.label.split()))
    # A row of units has lost its outer brackets: of ``(dB (um/V))`` this is left.
    stated += [text + ")" for text in stated if text.count("(") > text.count(")")]
    stated += [a or b for a, b in reversed(_BRACKETS.findall(label))]
    stated += [match.group(1) for end in _AT_THE_END if (match := end.match(label))]
    return next((unit for text in stated if (unit := response_unit(text)) is not None), None)
