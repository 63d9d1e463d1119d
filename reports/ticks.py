"""Round numbers along an axis, in equal steps or over decades; the script makes the same."""

import math

from piezoid_reports.quantities import MINUS

MOST = 7  # intervals between labels
FEWEST = 3  # labels of an axis over decades
MANTISSAS = ((1,), (1, 2, 5), tuple(range(1, 10)))

Ticks = tuple[tuple[float, str], ...]  # place along the axis, label


def even_ticks(low: float, high: float) -> Ticks:
    """Return round numbers from low to high."""
    step = round_step((high - low) / MOST)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return tuple((k * step, _written(k * step, step)) for k in range(first, last + 1))


def decade_ticks(low: float, high: float) -> Ticks:
    """Return round numbers where the axis runs over powers of ten: ends and places are log10."""
    for mantissas in MANTISSAS:
        found = [
            (k + math.log10(m), m, k)
            for k in range(math.floor(low), math.ceil(high) + 1)
            for m in mantissas
            if low - 1e-9 <= k + math.log10(m) <= high + 1e-9
        ]
        if len(found) >= FEWEST:
            apart = math.ceil(len(found) / MOST) if mantissas == (1,) else 1
            return tuple((place, _power(m, k)) for place, m, k in found if k % apart == 0)
    near = [(value, label) for value, label in even_ticks(10.0**low, 10.0**high) if value > 0.0]
    return tuple((math.log10(value), label) for value, label in near)


def round_step(size: float) -> float:
    """Return the round number next above a step."""
    power = 10.0 ** math.floor(math.log10(size))
    for digit in (1.0, 2.0, 5.0):
        if size <= digit * power * 1.0000001:
            return digit * power
    return 10.0 * power


def _written(value: float, step: float) -> str:
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value + 0.0:.{decimals}f}".replace("-", MINUS)


def _power(mantissa: int, power: int) -> str:
    if 0 <= power < 6:
        return str(mantissa * 10**power)
    if -4 <= power < 0:
        return f"{mantissa * 10.0**power:.{-power}f}"
    return f"{mantissa}e{power}".replace("-", MINUS)
