"""Numbers for readers: engineering units chosen for each number, its interval beside it."""

import math
from dataclasses import dataclass

PREFIXES = ((1e-12, "p"), (1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""), (1e3, "k"), (1e6, "M"))
UNKNOWN = "not known"
NARROW = "\u202f"  # a narrow space at which no line breaks: number and unit stay together
MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A unit a reader likes: so many SI units make one of it.

    factor  SI units in one of it
    unit    its name, empty for a plain number
    """

    factor: float
    unit: str


def scale_for(largest: float, unit: str) -> Scale:
    """Return the scale in which a number of this size has one to three digits before the point.

    largest  size of the number in SI
    unit     SI unit; ``%`` and the empty one take no prefix, nor do angles
    """
    size = abs(largest)
    if unit in ("", "%") or not math.isfinite(size) or size == 0.0:
        return Scale(factor=1.0, unit=unit)
    # A number that rounds up to 1000 belongs to the next prefix.
    below = [(factor, prefix) for factor, prefix in PREFIXES if factor <= size * 1.0005]
    factor, prefix = below[-1] if below else PREFIXES[0]
    return Scale(factor=factor, unit=prefix + unit)


def told(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit, for example ``66.0 nm``."""
    if not math.isfinite(value):
        return UNKNOWN
    scale = scale_for(value, unit)
    return _joined(significant(value / scale.factor, digits), scale.unit)


def told_between(value: float, half: float, unit: str) -> str:
    """Return a number and half its 95 % interval, both to the digits the interval allows."""
    if not (math.isfinite(value) and math.isfinite(half)):
        return told(value, unit)
    scale = scale_for(max(abs(value), half), unit)
    shown, spread = value / scale.factor, half / scale.factor
    if spread == 0.0:
        return f"{told(value, unit, 4)} (fixed)"
    decimals = min(max(1 - math.floor(math.log10(spread)), 0), 6)
    pair = f"{shown:.{decimals}f}{NARROW}±{NARROW}{spread:.{decimals}f}".replace("-", MINUS)
    return _joined(f"({pair})" if scale.unit else pair, scale.unit)


def significant(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, without an exponent where it can be."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    place = math.floor(math.log10(abs(rounded)))
    if not -5 <= place < 9:
        return f"{rounded:.{digits - 1}e}".replace("-", MINUS)
    return f"{rounded:.{max(digits - 1 - place, 0)}f}".replace("-", MINUS)


def percent(share: float) -> str:
    """Return a share of one in percent."""
    return told(100.0 * share, "%")


def _joined(number: str, unit: str) -> str:
    return f"{number}{NARROW}{unit}" if unit else number
