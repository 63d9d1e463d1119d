"""Creep with thresholds: small steps do not creep at all."""

from dataclasses import dataclass
from math import exp
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.numerics.arrays import Array
from piezoid.operators.limits import crept

MOST = 0.5


@dataclass(frozen=True, kw_only=True)
class CreepOperator(Extension):
    """Thresholded integrators behind the hysteresis, the creep operator of Kuhnen & Krejci.

        y = m + sum_i c_i x_i
        x_i[k+1] = x_i[k] + (1 - exp(-T / tau_i)) max(e - r_i, min(e + r_i, 0)),  e = m[k] - x_i[k]

    tau_i  time_s       (elements,)  s, > 0
    r_i    threshold_m  (elements,)  m, >= 0; 0 makes an element of a relaxation ladder
    c_i    share        (elements,)  1, 0 to 0.5

    Not linear: what goes wrong is a scaled signal. Steady before the first sample.
    """

    kind: ClassVar[str] = "creep_operator"

    time_s: tuple[float, ...]
    threshold_m: tuple[float, ...]
    share: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.time_s) == len(self.threshold_m) == len(self.share) > 0:
            raise ValueError("creep elements need a time, a threshold and a share each")
        for time_s, threshold_m, share in zip(
            self.time_s, self.threshold_m, self.share, strict=True
        ):
            within("creep time_s", time_s, 1e-6, 1e9)
            within("creep threshold_m", threshold_m, 0.0, 1.0)
            within("creep share", share, 0.0, MOST)

    def response(self, moved: Array, where: Where) -> Array:
        """Return the displacement with what crept, in m."""
        total = np.array(moved)
        for time_s, threshold_m, share in zip(
            self.time_s, self.threshold_m, self.share, strict=True
        ):
            part = 1.0 - exp(-1.0 / (time_s * where.rate_Hz))
            total += share * crept(moved, part, threshold_m)
        return total

    def free(self) -> Free:
        """Return the shares."""
        return free(self.share, 0.0, MOST, 1e-3)

    def moved_to(self, value: Array) -> Self:
        """Return other shares."""
        return type(self)(
            time_s=self.time_s, threshold_m=self.threshold_m, share=tuple(value.tolist())
        )
