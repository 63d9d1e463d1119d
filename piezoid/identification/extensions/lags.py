"""Lag between the channels: a first-order pole, a pure delay, and the hold of a converter."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import (
    NOTHING,
    Extension,
    Free,
    LoopEffect,
    Where,
    free,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.filters import later, relaxed
from piezoid.operators.linear import ContinuousSystem

MAX_LAG_s = 10.0
MAX_DELAY_s = 1.0
MAX_SAMPLES = 100.0


@dataclass(frozen=True, kw_only=True)
class FirstOrderLag(Extension):
    """An undeclared first-order lag.

        lag_s dy/dt = m - y

    lag_s  s, >= 0
    """

    kind: ClassVar[str] = "first_order_lag"
    is_fast: ClassVar[bool] = True
    fitted: ClassVar[tuple[str, ...]] = ("lag_s",)
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {
        "lag_s": ("lag_s", 0.0, MAX_LAG_s),
    }

    lag_s: float

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


@dataclass(frozen=True, kw_only=True)
class Delay(Extension):
    """Pure delay of the displacement: a cable, a servo, or a converter that delays rows.

        y(t) = m(t - delay_s - delay_samples / rate)

    delay_s        s, >= 0
    delay_samples  samples, >= 0, of a converter, whose delay is a number of rows, not a time
    """

    kind: ClassVar[str] = "delay"
    is_fast: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {
        "delay_s": ("delay_s", 0.0, MAX_DELAY_s),
        "delay_samples": ("delay_samples", 0.0, MAX_SAMPLES),
    }

    delay_s: float = 0.0
    delay_samples: float = 0.0

    def group_delay_s(self, rate_Hz: float) -> float:
        """Return the delay in a recording of this rate."""
        return self.delay_s + self.delay_samples / rate_Hz

    def response(self, displacement: Array, where: Where) -> Array:
        """Delay the displacement."""
        return later(displacement, self.group_delay_s(where.rate_Hz) * where.rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:
        """Return the delay."""
        return LoopEffect(dead_time_s=self.group_delay_s(rate_Hz))

    def at_corner(self, slower: float, sharper: float) -> Self:  # noqa: ARG002
        """Return the delay at an end of its interval."""
        half = NORMAL_95 * (self.std[0] if self.std else 0.0)
        if self.delay_samples > 0.0:
            samples = max(self.delay_samples + slower * half, 0.0)
            return replace(self, delay_samples=min(samples, MAX_SAMPLES))
        return replace(self, delay_s=min(max(self.delay_s + slower * half, 0.0), MAX_DELAY_s))

    def free(self) -> Free:
        """Return the delay in samples if it is above 0, else the delay in seconds."""
        if self.delay_samples > 0.0:
            return free(self.delay_samples, 0.0, MAX_SAMPLES, 0.01)
        return free(self.delay_s, 0.0, MAX_DELAY_s, max(1e-3 * self.delay_s, 1e-8))

    def moved_to(self, value: Array) -> Self:
        """Return another delay in the same unit."""
        if self.delay_samples > 0.0:
            return type(self)(delay_s=self.delay_s, delay_samples=max(float(value[0]), 1e-9))
        return type(self)(delay_s=float(value[0]))


@dataclass(frozen=True, kw_only=True)
class ConverterHold(Extension):
    """Hold of the converter: half a declared clock period of delay, which is not fitted.

    hold_s  s, >= 0, half a period of the converter's clock

    It describes the recordings only: the converter of the controller has a hold of its own.
    """

    kind: ClassVar[str] = "converter_hold"
    is_fast: ClassVar[bool] = True
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {
        "hold_s": ("hold_s", 0.0, 1.0),
    }

    hold_s: float

    def group_delay_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return the delay."""
        return self.hold_s

    def response(self, displacement: Array, where: Where) -> Array:
        """Delay the displacement, which is equivalent to a delay of the drive."""
        return later(displacement, self.hold_s * where.rate_Hz)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return no effect: the delay of the controller's own converter is part of its loop."""
        return NOTHING

    def free(self) -> Free:
        """Return no free numbers."""
        return free((), 0.0, 0.0, 1.0)
