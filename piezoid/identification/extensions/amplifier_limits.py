"""Amplifier limits: the output saturates at the supply, and the current limits its rate."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, LoopEffect, free, within
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import slewed

MAX_LEVEL_V = 1e5


@dataclass(frozen=True, kw_only=True)
class AmplifierLimits(Extension):
    """Saturation in front of the hysteresis, whose memory depends on the clipped voltage.

        u -> min(max(u, low), high)

    low_V, high_V  V, in the units of the recorded drive; None: no limit on that side
    """

    kind: ClassVar[str] = "amplifier_limits"

    low_V: float | None = None
    high_V: float | None = None

    def __post_init__(self) -> None:
        limits = self._levels
        if not limits:
            raise ValueError("amplifier limits without limits: low_V or high_V is needed")
        for value in limits:
            within("amplifier limit", value, -MAX_LEVEL_V, MAX_LEVEL_V)
        if len(limits) == 2 and not limits[0] < limits[1]:
            raise ValueError(f"amplifier limits are {limits}, expected rising")

    @property
    def _levels(self) -> tuple[float, ...]:
        return tuple(value for value in (self.low_V, self.high_V) if value is not None)

    def drive(self, voltage_V: Array, rate_Hz: float) -> Array:  # noqa: ARG002
        """Return the clipped voltage."""
        return np.asarray(np.clip(voltage_V, self.low_V, self.high_V))

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the range of the drive that reaches the ceramic."""
        low_V, high_V = self.low_V, self.high_V
        return LoopEffect(
            low_V=-np.inf if low_V is None else low_V, high_V=np.inf if high_V is None else high_V
        )

    def free(self) -> Free:
        """Return the levels of the limited sides."""
        largest_V = max(abs(value) for value in self._levels)
        return free(self._levels, -MAX_LEVEL_V, MAX_LEVEL_V, max(2e-4 * largest_V, 1e-9))

    def moved_to(self, value: Array) -> Self:
        """Return other levels on the same sides."""
        values = value.tolist()
        low = None if self.low_V is None else values.pop(0)
        return type(self)(low_V=low, high_V=None if self.high_V is None else values.pop(0))


@dataclass(frozen=True, kw_only=True)
class SlewLimit(Extension):
    """Largest slew rate in front of the hysteresis.

        |du/dt| <= limit_V_per_s

    limit_V_per_s  V/s, > 0, in the units of the recorded drive
    """

    kind: ClassVar[str] = "slew_limit"
    fitted: ClassVar[tuple[str, ...]] = ("limit_V_per_s",)
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {
        "limit_V_per_s": ("limit_V_per_s", 1e-12, 1e12),
    }

    limit_V_per_s: float

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
