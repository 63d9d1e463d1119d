"""Slew limit: the amplifier current limits the rate of the drive."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import slewed


@dataclass(frozen=True, kw_only=True)
class SlewLimit(Extension):
    """Largest slew rate in front of the hysteresis.

        |du/dt| <= limit_V_per_s

    limit_V_per_s  V/s, > 0, in the units of the recorded drive
    """

    kind: ClassVar[str] = "slew_limit"

    limit_V_per_s: float

    def __post_init__(self) -> None:
        within("limit_V_per_s", self.limit_V_per_s, 1e-12, 1e12)

    def drive(self, voltage_V: Array, rate_Hz: float) -> Array:
        """Return the voltage with limited slew rate."""
        step_V = self.limit_V_per_s / rate_Hz
        if float(np.abs(np.diff(voltage_V)).max(initial=0.0)) <= step_V:
            return voltage_V
        return slewed(voltage_V, step_V)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the largest slew rate of the drive that reaches the ceramic."""
        return LoopEffect(slew_V_per_s=self.limit_V_per_s)

    def free(self) -> Free:
        """Return the limit."""
        value = self.limit_V_per_s
        return free(value, 0.3 * value, 3.0 * value, 2e-4 * value)

    def moved_to(self, value: Array) -> Self:
        """Return another limit."""
        return type(self)(limit_V_per_s=float(value[0]))
