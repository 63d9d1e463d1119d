"""Units as laboratories write them in a column's heading, and their factors to SI."""

import re
from dataclasses import dataclass
from enum import Enum


class Dimension(Enum):
    """Dimension of a unit; the value is the SI unit to which it is converted.

    Only frequency responses have angles, gains, and decibels of an unknown reference.
    """

    TIME = "s"
    VOLTAGE = "V"
    LENGTH = "m"
    CURRENT = "A"
    TEMPERATURE = "K"
    RATIO = "1"
    FREQUENCY = "Hz"
    ANGLE = "rad"
    GAIN = "m/V"
    VOLTAGE_GAIN = "V/V"
    DECIBEL = "dB"
    OTHER = ""


@dataclass(frozen=True, kw_only=True)
class Unit:
    """One unit: ``SI = factor * value + offset``, or ``factor * 10^(value / 20)`` of decibels.

    symbol      as written in the file
    dimension   OTHER for units of quantities that a piezo stage does not have
    factor      to SI; 1 for OTHER, whose values are not converted
    offset      added after scaling; zero except for the degree Celsius
    is_decibel  whether the values are decibels of this unit
    """

    symbol: str
    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0
    is_decibel: bool = False

    @property
    def si_symbol(self) -> str:
        """The unit after conversion."""
        return self.symbol if self.dimension is Dimension.OTHER else self.dimension.value

    @property
    def is_counted(self) -> bool:
        """Whether the unit is the step of a converter, of unknown size."""
        return self.symbol.lower().removesuffix("s") in ("count", "code", "lsb", "digit", "tick")


@dataclass(frozen=True, kw_only=True)
class Heading:
    """Heading of a column, split: ``Current [bwd] (nA)`` is ``Current [bwd]`` in ``nA``.

    stem  the heading without its unit
    unit  None if the heading names none
    """

    stem: str
    unit: Unit | None


_PREFIXES = {
    "": 1.0, "f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3,
    "k": 1e3, "M": 1e6, "G": 1e9,
}  # fmt: skip

_BASES = {
    "s": Dimension.TIME,
    "V": Dimension.VOLTAGE,
    "m": Dimension.LENGTH,
    "A": Dimension.CURRENT,
    "K": Dimension.TEMPERATURE,
    "Hz": Dimension.FREQUENCY,
}

# Whole words, compared without case; a plural s is dropped first.
_WORDS = {
    "second": "s", "sec": "s", "millisecond": "ms", "msec": "ms", "microsecond": "us",
    "usec": "us", "nanosecond": "ns", "volt": "V", "millivolt": "mV", "kilovolt": "kV",
    "meter": "m", "metre": "m", "millimeter": "mm", "millimetre": "mm", "micron": "um",
    "micrometer": "um", "micrometre": "um", "nanometer": "nm", "nanometre": "nm",
    "picometer": "pm", "picometre": "pm", "amp": "A", "ampere": "A", "milliamp": "mA",
    "nanoamp": "nA", "picoamp": "pA", "kelvin": "K", "hertz": "Hz", "celsius": "°C",
    "degc": "°C", "deg c": "°C", "ºc": "°C", "percent": "%", "%rh": "%", "% rh": "%",
    "rh%": "%", "newton": "N", "gram": "g",
}  # fmt: skip

_SPECIAL = {
    "cm": (Dimension.LENGTH, 1e-2, 0.0),
    "Å": (Dimension.LENGTH, 1e-10, 0.0),
    "min": (Dimension.TIME, 60.0, 0.0),
    "h": (Dimension.TIME, 3600.0, 0.0),
    "°C": (Dimension.TEMPERATURE, 1.0, 273.15),
    "℃": (Dimension.TEMPERATURE, 1.0, 273.15),
    "%": (Dimension.RATIO, 1e-2, 0.0),
}

# Recognised to exclude columns of other quantities (newtons); never converted.
_OTHER = re.compile(
    r"(?:[fpnuµμmckMG]?(?:N|Pa|g|W|J|F|C|H|T|rad|deg|ohm|Ohm|Ω|l|L|bar|cps)|counts?|codes?|LSB|digits?|ticks?|°|deg|degree|dB"
    r"|arcsec|a\.?u\.?|arb\.?|rpm|[A-Za-zµμ°Ω%]+\s?/\s?[A-Za-z√µμ²³^0-9*·]+|[A-Za-z]+\^?-?[23²³]"
    r"|[A-Za-zµμ°Ω%]+\s?/\s?(?:sqrt|rt|√)\s?\(?[A-Za-z]+\)?)"
)

# Round brackets may be nested: the unit in ``(A/sqrt(Hz))`` is not that of the inner ones.
BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\)")
MAX_HEADING = 1000  # characters of a heading that are interpreted
_AFTER_SLASH = re.compile(r"^(.*\S)\s*/\s*([^\s/]+)$")
_AFTER_COMMA = re.compile(r"^(.*\S)\s*(?:,|\bin\b)\s*([^\s,]+)$")
_AFTER_UNDERSCORE = re.compile(r"^(.*[^\s_])_([^\s_]+)$")


def unit_of(symbol: str) -> Unit | None:
    """Return the unit of a symbol or word, or None if it is unknown.

    Case matters in symbols (``mV`` is not ``MV``, ``s`` is not ``S``), not in words (``Volts``).
    """
    text = symbol.strip()
    text = _WORDS.get(text.lower(), _WORDS.get(text.lower().removesuffix("s"), text))
    if text in _SPECIAL:
        dimension, factor, offset = _SPECIAL[text]
        return Unit(symbol=symbol.strip(), dimension=dimension, factor=factor, offset=offset)
    for base, dimension in _BASES.items():
        prefix = text.removesuffix(base)
        if text.endswith(base) and prefix in _PREFIXES:
            return Unit(symbol=symbol.strip(), dimension=dimension, factor=_PREFIXES[prefix])
    if _OTHER.fullmatch(text):
        return Unit(symbol=symbol.strip(), dimension=Dimension.OTHER)
    return None


def heading_of(label: str) -> Heading:
    """Split a heading into its name and its unit.

    Recognised forms: ``time [s]``, ``Voltage (V)``, ``U/V``, ``Position_um``, ``current, nA``.
    Brackets take precedence. A heading of a single symbol (``V``) is ambiguous and read as a name.
    """
    label = " ".join(label[:MAX_HEADING].split())
    for brackets in reversed(list(BRACKETS.finditer(label))):
        content = brackets.group(1) or brackets.group(2) or ""
        unit = unit_of(content) or unit_of(content.partition(",")[0])  # ``[um, filtered]``
        if unit is not None:
            stem = label[: brackets.start()] + " " + label[brackets.end() :]
            return Heading(stem=" ".join(stem.split()), unit=unit)
    for pattern in (_AFTER_SLASH, _AFTER_COMMA, _AFTER_UNDERSCORE):
        match = pattern.match(label)
        if match is None:
            continue
        unit = unit_of(match.group(2))
        # A letter after an underscore is usually an index (``sensor_h``), seldom a rare unit.
        is_common = unit is not None and unit.dimension is not Dimension.OTHER
        if is_common and match.group(2) not in ("h", "min"):
            return Heading(stem=match.group(1), unit=unit)
    return Heading(stem=label, unit=None)
