"""Scale the physical parameter of an effect to a size, by proportion or by bisection."""

import math
from collections.abc import Callable, Iterable, Sequence

from piezoid_datasets.virtual_lab.effects.effect import Measure, Trace
from piezoid_datasets.virtual_lab.signals import Array

HALVINGS = 14  # of the logarithm of the range; a range of 1e4 is then known to 0.1 %


def largest(measure: Measure, changes: Iterable[Array]) -> float:
    """Return the size of an effect with these changes in the recordings of a campaign."""
    return max((measure.of(change) for change in changes), default=0.0)


def proportional(size_m: float, measure: Measure, unit: Iterable[Array], *, why: str) -> float:
    """Return the factor that scales changes of unit strength to a size.

    why  reason in the error message if no recording changes
    """
    reached_m = largest(measure, unit)
    if not reached_m > 0.0:
        raise ValueError(f"the campaign cannot show this effect: {why}")
    return size_m / reached_m


def bisected(
    size_m: float,
    measure: Measure,
    traces: Sequence[Trace],
    change: Callable[[Trace, float], Array],
    strengths: tuple[float, float],
) -> float:
    """Return the strength for which the largest change of a recording equals a size.

    change     (trace, strength) -> change of the displacement, increasing with the strength
    strengths  physical range of the strength; its nearer end is returned if no strength fits
    """
    weak, strong = strengths
    for _ in range(HALVINGS):
        middle = math.sqrt(weak * strong)
        if largest(measure, (change(trace, middle) for trace in traces)) < size_m:
            weak = middle
        else:
            strong = middle
    return math.sqrt(weak * strong)
