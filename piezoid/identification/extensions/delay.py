"""A pure delay between the channels."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.filters import later

MAX_DELAY_s = 1.0
MAX_SAMPLES = 100.0


@dataclass(frozen=True, kw_only=True)
class Delay(Extension):
    """Pure delay of the displacement: a cable, a servo, or a converter that delays rows.

        y(t) = m(t - delay_s - delay_samples / rate)

    delay_s        s, >= 0
    delay_samples  samples, >= 0, of a converter, whose delay is a number of rows, not a time
    """

    kind: ClassVar[str] = "delay"
    is_fast: ClassVar[bool] = True

    delay_s: float = 0.0
    delay_samples: float = 0.0

    def __post_init__(self) -> None:
        within("delay_s", self.delay_s, 0.0, MAX_DELAY_s)
        within("delay_samples", self.delay_samples, 0.0, MAX_SAMPLES)

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
