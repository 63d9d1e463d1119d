"""One mechanical mode behind the hysteresis."""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi
from typing import ClassVar, Self

import numpy as np

from piezoid.identification.extensions.extension import Extension, Free, Where, free, within
from piezoid.identification.extensions.loop_effect import LoopEffect
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.linear import ContinuousSystem, recursive_filter

LEAST_QUALITY, MOST_QUALITY = 0.5, 1e4
MOST_PART = 3.0
UNKNOWN_HALF, UNKNOWN_FACTOR = 0.05, 2.0  # of a mode that no fit gave an interval
LEAST_HALF, LEAST_FACTOR = 0.01, 1.2  # a mode moves with load, temperature and amplitude
MOST_FACTOR = 3.0


@dataclass(frozen=True, kw_only=True)
class LinearMode(Extension):
    """The stage is a mass on a spring, or a part of it is.

        y = m + p (x - m),   x'' + (w / Q) x' + w^2 x = w^2 m,   w = 2 pi f

    f  frequency_Hz   > 0
    Q  quality        0.5 to 1e4
    p  participation  0 to 3; 1: everything passes through the mode
    """

    kind: ClassVar[str] = "linear_mode"
    instant: ClassVar[bool] = True

    frequency_Hz: float
    quality: float
    participation: float = 1.0

    def __post_init__(self) -> None:
        within("mode frequency_Hz", self.frequency_Hz, 1e-3, 1e7)
        within("mode quality", self.quality, LEAST_QUALITY, MOST_QUALITY)
        within("mode participation", self.participation, 0.0, MOST_PART)

    def late_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return by how much slow motion comes later."""
        return self.participation / (2.0 * pi * self.frequency_Hz * self.quality)

    def response(self, displacement: Array, where: Where) -> Array:
        """Add the ringing of the mode to the displacement."""
        ringing = rung(displacement, self.frequency_Hz, self.quality, where.rate_Hz)
        return np.asarray(displacement + self.participation * (ringing - displacement))

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the mode in parallel to the instantaneous response."""
        w, part = 2.0 * pi * self.frequency_Hz, self.participation
        return LoopEffect(
            system=ContinuousSystem(
                A=np.array([[0.0, w], [-w, -w / self.quality]]),
                B=np.array([[0.0], [w]]),
                C=np.array([[part, 0.0]]),
                D=np.array([[1.0 - part]]),
            )
        )

    def at_corner(self, slower: float, sharper: float) -> Self:
        """Return the mode at an end of its intervals; of a mode without any, at a wide one."""
        half, factor = mode_spread(self.frequency_Hz, self.quality, self.std)
        return replace(
            self,
            frequency_Hz=self.frequency_Hz * (1.0 - slower * half),
            quality=min(max(self.quality * factor**sharper, LEAST_QUALITY), MOST_QUALITY),
        )

    def free(self) -> Free:
        """Return frequency, quality and participation."""
        value = np.array([self.frequency_Hz, self.quality, self.participation])
        lower = (0.7 * self.frequency_Hz, LEAST_QUALITY, 0.0)
        upper = (1.4 * self.frequency_Hz, MOST_QUALITY, MOST_PART)
        return free(value, lower, upper, value * 1e-4 + 1e-9)

    def moved_to(self, value: Array) -> Self:
        """Return another mode."""
        f, quality, part = value.tolist()
        return type(self)(frequency_Hz=f, quality=quality, participation=part)


def rung(signal: Array, frequency_Hz: float, quality: float, rate_Hz: float) -> Array:
    """Filter by one mode, x'' + (w / Q) x' + w^2 x = w^2 u, with u linear between samples.

    signal  (samples,) or (samples, columns)
    """
    fraction, start = _mode(frequency_Hz, quality, rate_Hz), signal[:1]
    changes = np.atleast_2d((signal - start).T)
    rung_up = [recursive_filter(*fraction, change) for change in changes]
    return np.asarray(np.stack(rung_up).T.reshape(signal.shape) + start)


@lru_cache(maxsize=256)
def _mode(frequency_Hz: float, quality: float, rate_Hz: float) -> tuple[Array, Array]:
    """Return numerator and denominator, sampled exactly behind a first-order hold."""
    from scipy.signal import cont2discrete

    w = 2.0 * np.pi * frequency_Hz
    system = ([w * w], [1.0, w / quality, w * w])
    b, a, _ = cont2discrete(system, 1.0 / rate_Hz, method="foh")
    return np.asarray(b).ravel(), np.asarray(a)


def mode_spread(
    frequency_Hz: float, quality: float, std: tuple[float, ...]
) -> tuple[float, float]:
    """Return how far a mode may be off: half the relative width of its frequency, factor of Q.

    std  standard errors of frequency and quality, at least; empty where they are not known
    """
    if len(std) < 2 or not (std[0] > 0.0 and std[1] > 0.0):
        return UNKNOWN_HALF, UNKNOWN_FACTOR
    half = max(NORMAL_95 * std[0] / frequency_Hz, LEAST_HALF)
    factor = max(float(np.exp(min(NORMAL_95 * std[1] / quality, 3.0))), LEAST_FACTOR)
    return min(half, 0.5), min(factor, MOST_FACTOR)


@dataclass(frozen=True, kw_only=True)
class StruckMode(LinearMode):
    """A mode that was identified from free decays and is not refitted.

    Where few of all samples ring, or none, a fit would rather have a blunt mode for a lag.
    """

    def free(self) -> Free:
        """Return the numbers where they are."""
        value = np.array([self.frequency_Hz, self.quality, self.participation])
        return free(value, value, value, value * 1e-4 + 1e-9)
