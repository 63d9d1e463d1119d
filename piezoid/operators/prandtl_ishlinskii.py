"""Prandtl-Ishlinskii operators: weighted plays, their exact inverse and their differences."""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import NotInvertibleError
from piezoid.numerics.arrays import Array, freeze, same_length, strictly_increasing
from piezoid.operators.library import KERNELS, address, contiguous


@dataclass(frozen=True, kw_only=True, eq=False)
class PrandtlIshlinskii:
    """A weighted sum of plays.

        h[k] = sum_i w_i z_i[k],   W_i = w_0 + ... + w_i,   phi(s) = sum_j w_j max(s - r_j, 0)

    r  threshold  (plays,)  unit of the input, r_0 = 0, strictly increasing
    w  weight     (plays,)  output per unit of input

    Has an inverse of the same class if every cumulative slope W_i is positive; single weights may
    be negative.                                                     [Krejci & Kuhnen 2001]
    """

    threshold: Array
    weight: Array

    def __post_init__(self) -> None:
        freeze(self, "threshold", "weight")
        same_length([("threshold", self.threshold), ("weight", self.weight)])
        strictly_increasing(self.threshold, "threshold")
        if self.threshold[0] != 0.0:
            raise ValueError(f"threshold[0] is {self.threshold[0]}, expected 0")

    @property
    def slope(self) -> Array:
        """Cumulative slopes W_i, (plays,)."""
        return np.cumsum(self.weight)

    def virgin_memory(self) -> Array:
        """Return the de-poled state: every play at zero, the input at zero."""
        return np.zeros_like(self.threshold)

    def run(self, values: Array, memory: Array) -> tuple[Array, Array]:
        """Return the output and the memory after the last sample.

        values  (samples,)  input
        memory  (plays,)    admissible states before the first sample
        """
        source = contiguous(values)
        state = np.array(memory, dtype=np.float64)
        output = np.empty_like(source)
        KERNELS.pk_play_sum(
            len(source),
            address(source),
            len(state),
            address(self.threshold),
            address(self.weight),
            address(state),
            address(output),
        )
        return output, state

    def loading_curve(self, s: Array) -> Array:
        """Return phi(s) for s >= 0: the response of the virgin operator to a first rise."""
        reach = np.maximum(np.asarray(s)[:, None] - self.threshold, 0.0)
        return np.asarray(reach @ self.weight)

    def inverse(self) -> "PrandtlIshlinskii":
        """Return the inverse operator.

            r'_i = phi(r_i);  w'_0 = 1 / W_0;  w'_i = 1 / W_i - 1 / W_(i-1)

        Its memory is ``inverse_memory`` of that of this operator. Raises ``NotInvertibleError`` if
        a W_i <= 0.
        """
        slope = self.slope
        if not (slope > 0).all():
            row = int(np.argmin(slope))
            raise NotInvertibleError(
                f"the cumulative slope W_{row} is {slope[row]:.6g}",
                needed="every cumulative slope must be positive for an inverse",
                remedy="Refit with non-negative weights.",
            )
        return PrandtlIshlinskii(
            threshold=self.loading_curve(self.threshold),
            weight=np.diff(1.0 / slope, prepend=0.0),
        )

    def inverse_memory(self, memory: Array) -> Array:
        """Return the memory of the inverse operator for a memory of this one.

        z'_i = W_i z_i + sum_(j>i) w_j z_j
        """
        product = self.weight * memory
        tail = np.cumsum(product[::-1])[::-1] - product
        return np.asarray(self.slope * memory + tail)


@dataclass(frozen=True, kw_only=True, eq=False)
class WorstCase:
    """Supremum of the difference over all inputs in a range, and an input that attains it.

    bound    output unit; supremum over inputs |u| <= R and over time, from the virgin state
    extrema  (count,)  alternating extrema of the input
    """

    bound: float
    extrema: Array


def worst_case(first: PrandtlIshlinskii, second: PrandtlIshlinskii, reach: float) -> WorstCase:
    """Return the exact worst difference of two operators over all inputs with |u| <= reach.

        B(R) = integral_0^R |W_1(r) - W_2(r)| dr

    Both start in the same admissible memory with |z(r)| <= max(R - r, 0), for example virgin. The
    attaining input has the extrema u = lambda(c) + s c at the corners c of a memory curve of slope
    -sign(W_1 - W_2), from wide plays to narrow ones.
    """
    # Between the edges both slopes are constant: that of the last play whose threshold is below.
    inner = np.concatenate([first.threshold, second.threshold])
    edges = np.unique(np.concatenate([[0.0, reach], inner[inner < reach]]))
    middle = (edges[1:] + edges[:-1]) / 2
    slopes = [
        operator.slope[np.searchsorted(operator.threshold, middle, side="right") - 1]
        for operator in (first, second)
    ]
    difference = slopes[0] - slopes[1]
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
