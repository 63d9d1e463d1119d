"""Rate dependence: a lag of the irreversible part."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, LoopEffect, free, within
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.filters import activated, relaxed

MIN_TIME_s, MAX_TIME_s = 1e-9, 10.0
MIN_STRAIN_m, MAX_STRAIN_m = 1e-12, 1.0
STEP = 1e-3  # of a number, for finite differences


@dataclass(frozen=True, kw_only=True)
class RateDependence(Extension):
    """Thermally activated motion of domain walls; the reversible part has no delay.

        dx/dt = (s / tau) sinh((h - x) / s),   h the irreversible part of a slow drive
        dx/dt = (h - x) / tau                  if s is 0: the lag does not lower the barriers

    tau  time_s    s, > 0   time constant of small lags
    s    strain_m  m, >= 0  lags beyond it grow with the logarithm of the speed

    Source: Eyring (1936); Smith (2005).
    """

    kind: ClassVar[str] = "rate_dependence"

    time_s: float
    strain_m: float = 0.0

    def __post_init__(self) -> None:
        within("rate dependence time_s", self.time_s, MIN_TIME_s, MAX_TIME_s)
        if self.strain_m != 0.0:
            within("rate dependence strain_m", self.strain_m, MIN_STRAIN_m, MAX_STRAIN_m)

    def irreversible(self, part_m: Array, rate_Hz: float) -> Array:
        """Return the delayed irreversible part, (samples,)."""
        if self.strain_m > 0.0:
            return activated(part_m, self.time_s, rate_Hz, self.strain_m)
        return relaxed(part_m, self.time_s, rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return time constant and strain of the irreversible part."""
        return LoopEffect(activation_s=self.time_s, activation_m=self.strain_m)

    def at_corner(self, slower: float, sharper: float) -> Self:  # noqa: ARG002
        """Return the time constant at an end of its interval, but at least a tenth of it."""
        half_s = NORMAL_95 * (self.std[0] if self.std else 0.0)
        time_s = max(self.time_s + slower * half_s, 0.1 * self.time_s)
        return replace(self, time_s=min(max(time_s, MIN_TIME_s), MAX_TIME_s))

    def free(self) -> Free:
        """Return the time constant, and the strain unless it is 0."""
        count = 2 if self.strain_m > 0.0 else 1
        value = np.array([self.time_s, self.strain_m][:count])
        lower, upper = (MIN_TIME_s, MIN_STRAIN_m), (MAX_TIME_s, MAX_STRAIN_m)
        return free(value, lower[:count], upper[:count], STEP * value)

    def moved_to(self, value: Array) -> Self:
        """Return another time constant, and another strain unless it is 0."""
        strain_m = float(value[1]) if len(value) > 1 else 0.0
        return type(self)(time_s=float(value[0]), strain_m=strain_m)
