"""Amplifier limits: the output saturates at the supply."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array

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

    @property
    def _range(self) -> tuple[float, float]:
        low = -np.inf if self.low_V is None else self.low_V
        return low, np.inf if self.high_V is None else self.high_V

    def drive(self, voltage_V: Array, rate_Hz: float) -> Array:  # noqa: ARG002
        """Return the clipped voltage."""
        low, high = self._range
        return np.asarray(np.clip(voltage_V, low, high))

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the range of the drive that reaches the ceramic."""
        low, high = self._range
        return LoopEffect(low_V=low, high_V=high)

    def free(self) -> Free:
        """Return the levels of the limited sides."""
        largest_V = max(abs(value) for value in self._levels)
        return free(self._levels, -MAX_LEVEL_V, MAX_LEVEL_V, max(2e-4 * largest_V, 1e-9))

    def moved_to(self, value: Array) -> Self:
        """Return other levels on the same sides."""
        values = value.tolist()
        low = None if self.low_V is None else values.pop(0)
        return type(self)(low_V=low, high_V=None if self.high_V is None else values.pop(0))
