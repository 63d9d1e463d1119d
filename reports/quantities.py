"""Numbers as text, with engineering units and 95 % intervals."""

import math
from typing import TYPE_CHECKING

from piezoid import formatting
from piezoid.formatting import UNKNOWN, interval_digits, scale_for, with_unit

if TYPE_CHECKING:
    from piezoid.diagnosis.diagnosis import Finding

NARROW = "\u202f"  # narrow no-break space between number and unit
MINUS = "\N{MINUS SIGN}"


def number(value: float, unit: str, digits: int = 3) -> str:
    """Return a number with its unit, for example ``66.0 nm``."""
    text = with_unit(value, unit, digits)
    return text if text == UNKNOWN else text.replace(" ", NARROW).replace("-", MINUS)


def with_half_width(value: float, half: float, unit: str) -> str:
    """Return a number and half its 95 % interval, both with the digits the interval allows."""
    if not (math.isfinite(value) and math.isfinite(half)):
        return number(value, unit)
    scale = scale_for(max(abs(value), half), unit)
    middle, spread = value / scale.factor, half / scale.factor
    if spread == 0.0:
        return f"{number(value, unit, 4)} (fixed)"
    decimals = min(max(1 - math.floor(math.log10(spread)), 0), 6)
    pair = f"{middle:.{decimals}f}{NARROW}±{NARROW}{spread:.{decimals}f}".replace("-", MINUS)
    return f"({pair}){NARROW}{scale.unit}" if scale.unit else pair


def significant(value: float, digits: int = 3) -> str:
    """Return a number with a typographic minus; see `piezoid.formatting.significant`."""
    return formatting.significant(value, digits).replace("-", MINUS)


def percent(share: float) -> str:
    """Return a fraction as a percentage."""
    return number(100.0 * share, "%")


def with_interval(value: float, interval: tuple[float, float], unit: str) -> str:
    """Return a value and its 95 % interval, which need not be symmetric or bounded."""
    low, high = interval
    if low <= 0.0 and not math.isfinite(high):
        return "unknown (the interval is unbounded)"
    if unit in ("", "eV"):
        limits = [significant(end, 4) if math.isfinite(end) else "any" for end in (low, high)]
        middle = f"{significant(value, 4)}{NARROW}{unit}" if unit else significant(value, 4)
        return f"{middle} ({limits[0]} to {limits[1]})"
    if not math.isfinite(high):
        return f"{number(value, unit)} ({number(low, unit)} or more)"
    return f"{number(value, unit)} ({number(low, unit)} to {number(high, unit)})"


def size_of(finding: "Finding") -> str:
    """Return the size of a finding with its 95 % interval, one-sided if that includes zero."""
    size = finding.size
    digits = interval_digits(*size.ci95)
    value, low, high = (significant(x, digits) for x in (size.value, *size.ci95))
    if size.ci95[0] <= 0.0 < size.ci95[1]:
        return f"{value} {size.unit} (95 %: at most {high})"
    return f"{value} {size.unit} (95 %: {low} to {high})"
