"""Role, quantity and axis of a column from its name and its unit."""

import re
from dataclasses import dataclass

from piezoid.records.recording import Quantity
from piezoid.records.units import Dimension, Heading

DIMENSION_OF = {
    Quantity.VOLTAGE: Dimension.VOLTAGE,
    Quantity.DISPLACEMENT: Dimension.LENGTH,
    Quantity.CURRENT: Dimension.CURRENT,
    Quantity.TEMPERATURE: Dimension.TEMPERATURE,
    Quantity.HUMIDITY: Dimension.RATIO,
}


@dataclass(frozen=True, kw_only=True)
class Meaning:
    """Interpretation of one column: a time, a channel, or not read.

    is_time   whether the column is a time
    quantity  of a channel; None for other columns
    axis      of a channel; None if the name states none
    by_name   whether the name states the quantity; False if only the unit does
    reason    why a column is not read; empty for a time or a channel
    """

    is_time: bool = False
    quantity: Quantity | None = None
    axis: str | None = None
    by_name: bool = False
    reason: str = ""

    @property
    def is_read(self) -> bool:
        """Whether the column is a time or a channel."""
        return self.is_time or self.quantity is not None


_TIME_WORDS = frozenset(
    {
        "time", "t", "zeit", "temps", "timestamp", "timestamps", "stamp", "elapsed", "date",
        "datetime", "clock", "uhrzeit", "zeitstempel",
    }
)  # fmt: skip
# Oscilloscopes name a column in a unit of time ``X`` or ``x-axis``, or leave the name empty.
_ABSCISSA_WORDS = frozenset({"axis"})
_NAME_WORDS = {
    Quantity.VOLTAGE: frozenset(
        {"voltage", "volt", "volts", "u", "v", "drive", "spannung", "tension"}
    ),
    Quantity.DISPLACEMENT: frozenset(
        {
            "displacement", "disp", "position", "pos", "deflection", "extension", "elongation",
            "stroke", "weg", "auslenkung", "sensor",
        }
    ),
    Quantity.CURRENT: frozenset({"current", "i", "strom", "tunnel", "tunnelling", "tunneling"}),
    Quantity.TEMPERATURE: frozenset({"temperature", "temp", "temperatur", "temperatura"}),
    Quantity.HUMIDITY: frozenset({"humidity", "rh", "feuchte", "feuchtigkeit"}),
}  # fmt: skip

# Columns of the right unit that are neither the applied drive nor a measured response: a set
# point, a difference, a property of an oscillation, the bias of the sample, a part of a complex
# response.
_OTHER_WORDS = frozenset(
    {
        "setpoint", "target", "desired", "error", "reference", "ref", "command", "commanded",
        "amplitude", "phase", "bias", "excitation", "offset", "std", "stddev", "model", "fit",
        "residual", "real", "imag",
    }
)  # fmt: skip

_TOKENS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_]+|\d+")
_SYMBOL_WITH_AXIS = re.compile(r"(?:[uv])([xyz])", re.IGNORECASE)
_AXES = ("x", "y", "z")


def meaning_of(heading: Heading) -> Meaning:
    """Return the meaning of a column by its name, or else by its unit.

    A name and a unit that contradict each other are resolved in columns.py, with the sensor gain
    that lab.toml may declare.
    """
    stem = re.sub(r"\[.*?\]|\(.*?\)", " ", heading.stem)
    tokens = [token.lower() for token in _TOKENS.findall(stem)]
    axes = {token for token in tokens if token in _AXES}
    words = set(tokens) - axes
    for token in tokens:
        if match := _SYMBOL_WITH_AXIS.fullmatch(token):
            axes.add(match.group(1))
            words.add(token[0])
    axis = axes.pop() if len(axes) == 1 else None
    dimension = None if heading.unit is None else heading.unit.dimension
    is_abscissa = dimension is Dimension.TIME and words <= _ABSCISSA_WORDS
    if is_abscissa or (words & _TIME_WORDS and dimension in (None, Dimension.TIME)):
        return Meaning(is_time=True)
    quantities = [quantity for quantity, names in _NAME_WORDS.items() if words & names]
    other_words = words & _OTHER_WORDS
    if other_words and not (dimension is Dimension.VOLTAGE and "command" in other_words):
        return Meaning(
            reason=f"named {min(other_words)!r}: neither applied to the stage nor measured on it"
        )
    if quantities == [Quantity.VOLTAGE, Quantity.DISPLACEMENT]:
        quantities = [Quantity.DISPLACEMENT]  # ``sensor voltage``: a position in volts
    if len(quantities) == 1:
        return Meaning(quantity=quantities[0], axis=axis, by_name=True)
    if dimension is Dimension.TIME:
        return Meaning(reason="a time whose name is not that of a clock")
    for quantity, expected in DIMENSION_OF.items():
        if expected is dimension and dimension is not Dimension.RATIO:
            return Meaning(quantity=quantity, axis=axis)
    if heading.unit is None:
        return Meaning(reason="neither name nor unit identifies the quantity")
    if heading.unit.is_counted:
        return Meaning(
            reason=f"in {heading.unit.symbol}, the steps of a converter, under a name of neither "
            "a drive nor a response: name the column in lab.toml, with scale"
        )
    return Meaning(reason=f"{heading.unit.symbol} is not a unit of a stage's drive or response")
