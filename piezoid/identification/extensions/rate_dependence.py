"""Rate dependence: a lag of the irreversible part."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.filters import relaxed
from piezoid.operators.limits import activated

SHORTEST_s, LONGEST_s = 1e-9, 10.0
WIDEST_m = 1.0
NARROWEST = 1e-12  # m: smallest strain of a domain wall
FELT = 1e-3  # of a number: a change that is felt


@dataclass(frozen=True, kw_only=True)
class RateDependence(Extension):
    """Walls climb their barriers by thermal activation; the reversible part is there at once.

        dx/dt = (s / tau) sinh((h - x) / s),   h the irreversible part without haste
        dx/dt = (h - x) / tau                        where s is 0: barriers the lag does not lower

    tau  time_s    s, > 0   time constant of small lags
    s    strain_m  m, >= 0  lags beyond it grow with the logarithm of the speed

    Source: Eyring (1936); Smith (2005).
    """

    kind: ClassVar[str] = "rate_dependence"

    time_s: float
    strain_m: float = 0.0

    def __post_init__(self) -> None:
        within("rate dependence time_s", self.time_s, SHORTEST_s, LONGEST_s)
        if self.strain_m != 0.0:
            within("rate dependence strain_m", self.strain_m, NARROWEST, WIDEST_m)

    def irreversible(self, part_m: Array, rate_Hz: float) -> Array:
        """Return the irreversible part as late as it comes."""
        if self.strain_m > 0.0:
            return activated(part_m, self.time_s, rate_Hz, self.strain_m)
        return relaxed(part_m, self.time_s, rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return how late the irreversible part comes."""
        return LoopEffect(activation_s=self.time_s, activation_m=self.strain_m)

    def at_corner(self, slower: float, sharper: float) -> Self:  # noqa: ARG002
        """Return the time constant at an end of its interval, a tenth of it at least."""
        half_s = NORMAL_95 * (self.std[0] if self.std else 0.0)
        moved_s = max(self.time_s + slower * half_s, 0.1 * self.time_s)
        return replace(self, time_s=min(max(moved_s, SHORTEST_s), LONGEST_s))

    def free(self) -> Free:
        """Return the time, and the strain where there is one."""
        value = np.array([self.time_s, self.strain_m][: 2 if self.strain_m > 0.0 else 1])
        lower, upper = (SHORTEST_s, NARROWEST)[: len(value)], (LONGEST_s, WIDEST_m)[: len(value)]
        return free(value, lower, upper, FELT * value)

    def moved_to(self, value: Array) -> Self:
        """Return another time, and another strain where there is one."""
        strain_m = float(value[1]) if len(value) > 1 else 0.0
        return type(self)(time_s=float(value[0]), strain_m=strain_m)
