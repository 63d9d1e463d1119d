"""Format numbers with a suitable prefix and three digits, without exponents."""

import math
from dataclasses import dataclass

PREFIXES = ((1e-12, "p"), (1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""), (1e3, "k"), (1e6, "M"))
UNKNOWN = "unknown"
MIN_SHARE = 1e-4  # smaller distances from 0 and 100 % are shown as a bound


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A unit with an SI prefix.

    factor  SI units per unit of this scale
    unit    name with prefix; empty for a number without unit
    """

    factor: float
    unit: str


def scale_for(largest: float, unit: str) -> Scale:
    """Return the scale in which a number has one to three digits before the decimal point.

    largest  the number in SI units
    unit     SI unit; ``%`` and the empty unit take no prefix
    """
    size = abs(largest)
    if unit in ("", "%") or not math.isfinite(size) or size == 0.0:
        return Scale(factor=1.0, unit=unit)
    # A number that rounds up to 1000 belongs to the next prefix.
    below = [(factor, prefix) for factor, prefix in PREFIXES if factor <= size * 1.0005]
    factor, prefix = below[-1] if below else PREFIXES[0]
    return Scale(factor=factor, unit=prefix + unit)


def words(name: str) -> str:
    """Return the name of an effect or coordinate for use in a sentence."""
    return name.replace("_", " ")


def count_of(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 figure``, ``3 figures``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit, for example ``66.0 nm``."""
    if not math.isfinite(value):
        return UNKNOWN
    scale = scale_for(value, unit)
    number = significant(value / scale.factor, digits)
    return f"{number} {scale.unit}" if scale.unit else number


def significant(value: float, digits: int = 3) -> str:
    """Format a number to significant digits, without an exponent if possible."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if not -5 <= exponent < 9:
        return f"{rounded:.{digits - 1}e}"
    return f"{rounded:.{max(digits - 1 - exponent, 0)}f}"


def resolved_percent(share: float) -> str:
    """Return a share of one in percent, with two digits of its distance from 0 and from 100 %.

    >>> resolved_percent(0.9998), resolved_percent(0.986), resolved_percent(0.43)
    ('99.98 %', '98.6 %', '43 %')
    """
    distance = min(share, 1.0 - share)
    if distance < MIN_SHARE:
        return "below 0.01 %" if share < 0.5 else "above 99.99 %"
    decimals = max(-math.floor(math.log10(100.0 * distance)) + 1, 0)
    number = f"{100.0 * share:.{decimals}f}"
    return f"{number.rstrip('0').rstrip('.') if decimals else number} %"


def interval_digits(low: float, high: float) -> int:
    """Return the number of significant digits, at least three, that resolve an interval.

    >>> interval_digits(399.9, 400.6)
    4
    """
    width, size = abs(high - low), max(abs(low), abs(high))
    if not (0.0 < width < size < math.inf):
        return 3
    return min(max(math.ceil(math.log10(size / width)) + 1, 3), 9)


def p_value(probability: float) -> str:
    """Return a p-value with two digits, or ``< 0.001``.

    >>> p_value(8.4e-8)
    '< 0.001'
    """
    return "< 0.001" if probability < 0.001 else significant(probability, 2)
