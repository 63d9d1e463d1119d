"""What is irreversible needs time to follow."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, free, within
from piezoid.identification.extensions.signals import later
from piezoid.numerics.arrays import Array

LONGEST_s = 1.0
WIDEST_m = 1.0


@dataclass(frozen=True, kw_only=True)
class RateDependence(Extension):
    """Plays come late, the reversible part does not.

        v -> v(t - beta),                       thresholds r + beta |du/dt| to first order
        v -> v - s asinh(beta v' / s)           with barriers that a lead lowers, s > 0

    beta  beta_s     s, >= 0
    s     barrier_m  m, >= 0; 0: the lag stays proportional to speed

    Source: Al Janaideh, Su & Rakheja (2008); Smith (2005).
    """

    kind: ClassVar[str] = "rate_dependence"

    beta_s: float
    barrier_m: float = 0.0

    def __post_init__(self) -> None:
        within("beta_s", self.beta_s, 0.0, LONGEST_s)
        within("barrier_m", self.barrier_m, 0.0, WIDEST_m)

    def irreversible(self, part_m: Array, rate_Hz: float) -> Array:
        """Return the irreversible part as late as it comes."""
        if self.barrier_m <= 0.0:
            return later(part_m, self.beta_s * rate_Hz)
        speed_m_per_s = np.gradient(part_m) * rate_Hz
        behind_m = self.barrier_m * np.arcsinh(self.beta_s * speed_m_per_s / self.barrier_m)
        return np.asarray(part_m - behind_m)

    def free(self) -> Free:
        """Return the time, and the barrier where there is one."""
        step_s = max(1e-3 * self.beta_s, 1e-8)
        if self.barrier_m <= 0.0:
            return free(self.beta_s, 0.0, LONGEST_s, step_s)
        value = (self.beta_s, self.barrier_m)
        lower, upper = (0.0, 1e-3 * self.barrier_m), (LONGEST_s, 1e3 * self.barrier_m)
        return free(value, lower, upper, (step_s, 1e-3 * self.barrier_m))

    def moved_to(self, value: Array) -> Self:
        """Return another time, and another barrier where there is one."""
        barrier_m = float(value[1]) if len(value) > 1 else 0.0
        return type(self)(beta_s=float(value[0]), barrier_m=barrier_m)
