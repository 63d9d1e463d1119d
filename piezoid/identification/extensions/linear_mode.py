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

MIN_QUALITY, MAX_QUALITY = 0.5, 1e4
MAX_PARTICIPATION = 3.0
DEFAULT_HALF, DEFAULT_FACTOR = 0.05, 2.0  # of a mode without standard errors
MIN_HALF, MIN_FACTOR = 0.01, 1.2  # a mode changes with load, temperature and amplitude
MAX_HALF, MAX_FACTOR = 0.5, 3.0


@dataclass(frozen=True, kw_only=True)
class LinearMode(Extension):
    """A vibration mode of the stage, or of a part of it.

        y = m + p (x - m),   x'' + (w / Q) x' + w^2 x = w^2 m,   w = 2 pi f

    f  frequency_Hz   > 0
    Q  quality        0.5 to 1e4
    p  participation  0 to 3; 1: all of the motion passes through the mode
    """

    kind: ClassVar[str] = "linear_mode"
    is_fast: ClassVar[bool] = True

    frequency_Hz: float
    quality: float
    participation: float = 1.0

    def __post_init__(self) -> None:
        within("mode frequency_Hz", self.frequency_Hz, 1e-3, 1e7)
        within("mode quality", self.quality, MIN_QUALITY, MAX_QUALITY)
        within("mode participation", self.participation, 0.0, MAX_PARTICIPATION)

    def group_delay_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return the group delay of the mode at low frequency."""
        return self.participation / (2.0 * pi * self.frequency_Hz * self.quality)

    def response(self, displacement: Array, where: Where) -> Array:
        """Filter the displacement by the mode, with its participation."""
        filtered = mode_filtered(displacement, self.frequency_Hz, self.quality, where.rate_Hz)
        return np.asarray(displacement + self.participation * (filtered - displacement))

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the mode in parallel to the instantaneous response."""
        w, participation = 2.0 * pi * self.frequency_Hz, self.participation
        return LoopEffect(
            system=ContinuousSystem(
                A=np.array([[0.0, w], [-w, -w / self.quality]]),
                B=np.array([[0.0], [w]]),
                C=np.array([[participation, 0.0]]),
                D=np.array([[1.0 - participation]]),
            )
        )

    def at_corner(self, slower: float, sharper: float) -> Self:
        """Return the mode at an end of its intervals, which are wide without standard errors."""
        half, factor = mode_spread(self.frequency_Hz, self.quality, self.std)
        return replace(
            self,
            frequency_Hz=self.frequency_Hz * (1.0 - slower * half),
            quality=min(max(self.quality * factor**sharper, MIN_QUALITY), MAX_QUALITY),
        )

    def free(self) -> Free:
        """Return frequency, quality and participation."""
        value = np.array([self.frequency_Hz, self.quality, self.participation])
        lower = (0.7 * self.frequency_Hz, MIN_QUALITY, 0.0)
        upper = (1.4 * self.frequency_Hz, MAX_QUALITY, MAX_PARTICIPATION)
        return free(value, lower, upper, value * 1e-4 + 1e-9)

    def moved_to(self, value: Array) -> Self:
        """Return another mode."""
        f, quality, participation = value.tolist()
        return type(self)(frequency_Hz=f, quality=quality, participation=participation)


def mode_filtered(signal: Array, frequency_Hz: float, quality: float, rate_Hz: float) -> Array:
    """Filter by one mode, x'' + (w / Q) x' + w^2 x = w^2 u, with u linear between samples.

    signal  (samples,) or (samples, columns)
    """
    fraction, start = _transfer_function(frequency_Hz, quality, rate_Hz), signal[:1]
    changes = np.atleast_2d((signal - start).T)
    filtered = [recursive_filter(*fraction, change) for change in changes]
    return np.asarray(np.stack(filtered).T.reshape(signal.shape) + start)


@lru_cache(maxsize=256)
def _transfer_function(frequency_Hz: float, quality: float, rate_Hz: float) -> tuple[Array, Array]:
    """Discretise a mode with a first-order hold; return numerator and denominator."""
    from scipy.signal import cont2discrete

    w = 2.0 * np.pi * frequency_Hz
    system = ([w * w], [1.0, w / quality, w * w])
    b, a, _ = cont2discrete(system, 1.0 / rate_Hz, method="foh")
    return np.asarray(b).ravel(), np.asarray(a)


def mode_spread(
    frequency_Hz: float, quality: float, std: tuple[float, ...]
) -> tuple[float, float]:
    """Return half the relative 95 % interval of a mode's frequency, and the factor of its quality.

    std  standard errors of frequency and quality, then of others; empty: unknown
    """
    if len(std) < 2 or not (std[0] > 0.0 and std[1] > 0.0):
        return DEFAULT_HALF, DEFAULT_FACTOR
    half = max(NORMAL_95 * std[0] / frequency_Hz, MIN_HALF)
    factor = max(float(np.exp(min(NORMAL_95 * std[1] / quality, 3.0))), MIN_FACTOR)
    return min(half, MAX_HALF), min(factor, MAX_FACTOR)


@dataclass(frozen=True, kw_only=True)
class StruckMode(LinearMode):
    """A mode that was identified from free decays and is not refitted.

    If few samples or none contain its ringing, a fit would use the mode as a lag with low quality.
    """

    def free(self) -> Free:
        """Return the numbers with equal lower and upper bounds."""
        value = np.array([self.frequency_Hz, self.quality, self.participation])
        return free(value, value, value, value * 1e-4 + 1e-9)
