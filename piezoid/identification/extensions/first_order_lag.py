"""A first-order pole behind the hysteresis."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import NOTHING, LoopEffect
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.filters import relaxed
from piezoid.operators.linear import ContinuousSystem

MAX_LAG_s = 10.0


@dataclass(frozen=True, kw_only=True)
class FirstOrderLag(Extension):
    """An undeclared first-order lag.

        lag_s dy/dt = m - y

    lag_s  s, >= 0
    """

    kind: ClassVar[str] = "first_order_lag"
    is_fast: ClassVar[bool] = True

    lag_s: float

    def __post_init__(self) -> None:
        within("lag_s", self.lag_s, 0.0, MAX_LAG_s)

    def group_delay_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return the lag."""
        return self.lag_s

    def response(self, displacement: Array, where: Where) -> Array:
        """Filter the displacement by the pole."""
        return relaxed(displacement, self.lag_s, where.rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the pole."""
        if self.lag_s == 0.0:
            return NOTHING
        rate_per_s, unit = 1.0 / self.lag_s, np.ones((1, 1))
        pole = ContinuousSystem(A=-rate_per_s * unit, B=rate_per_s * unit, C=unit, D=0.0 * unit)
        return LoopEffect(system=pole)

    def at_corner(self, slower: float, sharper: float) -> Self:  # noqa: ARG002
        """Return the lag at an end of its interval, but at least a tenth of the lag."""
        half_s = NORMAL_95 * (self.std[0] if self.std else 0.0)
        lag_s = max(self.lag_s + slower * half_s, 0.1 * self.lag_s)
        return replace(self, lag_s=min(lag_s, MAX_LAG_s))

    def free(self) -> Free:
        """Return the lag."""
        return free(self.lag_s, 0.0, MAX_LAG_s, max(1e-3 * self.lag_s, 1e-8))

    def moved_to(self, value: Array) -> Self:
        """Return another lag."""
        return type(self)(lag_s=float(value[0]))
