"""One-sided dead zones: the static part of the modified model, and its exact inverse."""

import ctypes
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezoid.errors import NotInvertibleError
from piezoid.numerics.arrays import Array, freeze, same_length, strictly_increasing
from piezoid.operators.library import KERNELS, address, contiguous


class KernelMap(ctypes.Structure):
    """Structure ``pk_map`` of the kernels, with references to its arrays."""

    _fields_ = (
        ("knots", ctypes.c_size_t),
        ("knot", ctypes.c_void_p),
        ("slope", ctypes.c_void_p),
        ("zero", ctypes.c_size_t),
    )
    arrays: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, eq=False)
class DeadZones:
    """A superposition of one-sided dead zones: continuous, piecewise linear, 0 at 0.

        s_r(h) = max(h - r, 0) if r > 0; min(h - r, 0) if r < 0; h if r = 0
        Psi(h) = sum_j w_j s_(r_j)(h)                                     [Kuhnen 2003]

    r  threshold  (zones,)  unit of h, strictly increasing, containing 0
    w  weight     (zones,)  output per unit of h; the weight at r = 0 is the slope at the origin

    Kuhnen's symbol of the map is S, which denotes a polynomial and a sensitivity here.
    """

    threshold: Array
    weight: Array

    def __post_init__(self) -> None:
        freeze(self, "threshold", "weight")
        same_length([("threshold", self.threshold), ("weight", self.weight)])
        strictly_increasing(self.threshold, "threshold")
        if 0.0 not in self.threshold:
            raise ValueError("threshold has no 0: the central dead zone is missing")

    @cached_property
    def zero(self) -> int:
        """Index of the central dead zone, r = 0."""
        return int(self.threshold.tolist().index(0.0))

    @cached_property
    def slope(self) -> Array:
        """Slopes below, between and above the thresholds, (zones + 1,), read-only."""
        above = np.cumsum(self.weight[self.zero :])
        below = np.cumsum(self.weight[self.zero :: -1])[::-1]
        slope = np.concatenate([below, above])
        slope.setflags(write=False)
        return slope

    def run(self, h: Array, *, slope_out: Array | None = None) -> Array:
        """Return Psi(h), sample by sample, and write the local slope Psi'(h) to ``slope_out``."""
        source = contiguous(h)
        output, view = np.empty_like(source), self.kernel_map()
        KERNELS.pk_piecewise_linear(
            len(source),
            address(source),
            ctypes.addressof(view),
            address(output),
            address(slope_out),
        )
        return output

    def run_with_slope(self, h: Array) -> tuple[Array, Array]:
        """Return Psi(h) and the local slope Psi'(h), both (samples,)."""
        local = np.empty(len(h))
        return self.run(h, slope_out=local), local

    def kernel_map(self) -> KernelMap:
        """Return the map in the layout of the C kernels."""
        knot, slope = self.threshold, self.slope
        view = KernelMap(len(knot), address(knot), address(slope), self.zero)
        view.arrays = (knot, slope)
        return view

    def columns(self, h: Array) -> Array:
        """Return s_r(h) for every threshold, (samples, zones), column-major."""
        columns = np.empty((len(h), len(self.threshold)), order="F")
        for j, r in enumerate(self.threshold):
            column = np.subtract(h, r, out=columns[:, j])
            if r > 0:
                np.maximum(column, 0.0, out=column)
            elif r < 0:
                np.minimum(column, 0.0, out=column)
        return columns

    def inverse(self) -> "DeadZones":
        """Return Psi^-1, again a superposition of dead zones.

            r'_j = Psi(r_j);  w'_0 = 1 / w_0;  w'_j = 1 / slope_j - 1 / slope_(j-1)

        Raises ``NotInvertibleError`` if a slope is not positive.
        """
        slope = self.slope
        if not (slope > 0).all():
            raise NotInvertibleError(
                f"a slope of the dead-zone superposition is {slope.min():.6g}",
                needed="all slopes must be positive for an inverse",
                remedy="Refit with the slopes bounded away from zero.",
            )
        return from_slopes(self.run(self.threshold), 1.0 / slope)


def from_slopes(threshold: Array, slope: Array) -> DeadZones:
    """Return the superposition with given slopes between given thresholds.

    threshold  (zones,)      strictly increasing, containing 0
    slope      (zones + 1,)  the two slopes that meet at 0 must be equal
    """
    zero = threshold.tolist().index(0.0)
    weight = np.empty_like(threshold)
    weight[zero + 1 :] = np.diff(slope[zero + 1 :])
    weight[:zero] = -np.diff(slope[: zero + 1])
    weight[zero] = slope[zero]
    return DeadZones(threshold=threshold, weight=weight)


LINEAR = DeadZones(threshold=np.zeros(1), weight=np.ones(1))
