"""Largest difference of two Prandtl-Ishlinskii operators, and the input that attains it."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii


@dataclass(frozen=True, kw_only=True, eq=False)
class WorstCase:
    """Supremum of the difference over all inputs in a range, and an input that attains it.

    bound    output unit; supremum over inputs |u| <= R and over time, from the virgin state
    extrema  (count,)  alternating extrema of the input
    """

    bound: float
    extrema: Array


def slope_difference(
    first: PrandtlIshlinskii, second: PrandtlIshlinskii, reach: float
) -> tuple[Array, Array]:
    """Return the edges in [0, reach] between which both slopes are constant, and W1 - W2.

    returned  (edges,) increasing from 0 to reach, and (edges - 1,)
    """
    inner = np.concatenate([first.threshold, second.threshold])
    edges = np.unique(np.concatenate([[0.0, reach], inner[inner < reach]]))
    middle = (edges[1:] + edges[:-1]) / 2
    return edges, _slope_at(first, middle) - _slope_at(second, middle)


def worst_case(first: PrandtlIshlinskii, second: PrandtlIshlinskii, reach: float) -> WorstCase:
    """Return the exact worst difference of two operators over all inputs with |u| <= reach.

        B(R) = integral_0^R |W_1(r) - W_2(r)| dr

    Both start in the same admissible memory with |z(r)| <= max(R - r, 0), for example virgin. The
    attaining input has the extrema u = lambda(c) + s c at the corners c of a memory curve of slope
    -sign(W_1 - W_2), from wide plays to narrow ones.
    """
    edges, difference = slope_difference(first, second, reach)
    bound = float((np.abs(difference) * np.diff(edges)).sum())
    sign = np.sign(difference)
    nonzero = np.flatnonzero(sign)
    if nonzero.size:  # where the operators agree the sign of a neighbour avoids a corner
        nearest = np.searchsorted(nonzero, np.arange(len(sign)))
        sign = sign[nonzero[np.clip(nearest, 0, len(nonzero) - 1)]]
    else:
        sign = np.ones_like(sign)
    extrema: list[float] = []
    corner = 0.0
    upper = len(sign)
    while upper > 0:
        lower = upper - 1
        while lower > 0 and sign[lower - 1] == sign[upper - 1]:
            lower -= 1
        s = sign[upper - 1]
        corner += s * (edges[upper] - edges[lower])
        extrema.append(corner + s * edges[lower])
        upper = lower
    return WorstCase(bound=bound, extrema=np.array(extrema))


def _slope_at(operator: PrandtlIshlinskii, r: Array) -> Array:
    """Return W(r): the slope of the last play whose threshold is at most r."""
    return np.asarray(operator.slope[np.searchsorted(operator.threshold, r, side="right") - 1])
