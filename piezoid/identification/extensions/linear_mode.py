"""One mechanical mode behind the hysteresis, and the rows in which its ringing is unresolved."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, pi
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
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.robust import NORMAL_95
from piezoid.operators.filters import each_column
from piezoid.operators.linear import ContinuousSystem, recursive_filter
from piezoid.records.drive_signal import isolated_steps

MIN_QUALITY, MAX_QUALITY = 0.5, 1e4
MAX_PARTICIPATION = 3.0
DEFAULT_HALF, DEFAULT_FACTOR = 0.05, 2.0  # of a mode without standard errors
MIN_HALF, MIN_FACTOR = 0.01, 1.2  # a mode changes with load, temperature and amplitude
MAX_HALF, MAX_FACTOR = 0.5, 3.0
# Behind isolated steps of the drive, whose instants between samples are unknown.
RESOLVED = 0.1  # of the sampling rate: within a sample the phase of the ringing turns 36 degrees
ROWS_AFTER_STEP = 2  # to which loop shape is not fitted
DECAY_TIMES = 8.0  # time constants of the ringing, after which 3e-4 remain


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
    fitted: ClassVar[tuple[str, ...]] = ("frequency_Hz", "quality", "participation")
    limits: ClassVar[Mapping[str, tuple[str, float, float]]] = {
        "frequency_Hz": ("mode frequency_Hz", 1e-3, 1e7),
        "quality": ("mode quality", MIN_QUALITY, MAX_QUALITY),
        "participation": ("mode participation", 0.0, MAX_PARTICIPATION),
    }

    frequency_Hz: float
    quality: float
    participation: float = 1.0

    def group_delay_s(self, rate_Hz: float) -> float:  # noqa: ARG002
        """Return the group delay of the mode at low frequency."""
        return self.participation / (2.0 * pi * self.frequency_Hz * self.quality)

    def response(self, displacement: Array, where: Where) -> Array:
        """Filter the displacement by the mode, with its participation."""
        w = 2.0 * pi * self.frequency_Hz
        fraction = second_order_filter(w, w / self.quality, where.rate_Hz)

        def filtered(column: Array) -> Array:
            shaped = recursive_filter(*fraction, column - column[:1]) + column[:1]
            return np.asarray(column + self.participation * (shaped - column))

        return each_column(filtered, displacement)

    def loop_effect(self, rate_Hz: float) -> LoopEffect:  # noqa: ARG002
        """Return the mode in parallel to the instantaneous response, if it takes part in it."""
        w, participation = 2.0 * pi * self.frequency_Hz, self.participation
        if participation == 0.0:  # a fit may end at this bound; a loop cannot observe the mode
            return NOTHING
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


@lru_cache(maxsize=256)
def second_order_filter(w: float, width: float, rate_Hz: float) -> tuple[Array, Array]:
    """Discretise w^2 / (s^2 + width s + w^2) with a first-order hold.

    w, width  1/s
    returned  numerator and denominator
    """
    from scipy.signal import cont2discrete

    system = ([w * w], [1.0, width, w * w])
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
class FixedMode(LinearMode):
    """A mode that was identified from free decays or a frequency response, and is not refitted.

    If few samples or none contain its ringing, a fit would use the mode as a lag of low quality.
    """

    def free(self) -> Free:
        """Return the numbers with equal lower and upper bounds."""
        value = np.array([self.frequency_Hz, self.quality, self.participation])
        return free(value, value, value, value * 1e-4 + 1e-9)


def rows_after_steps(
    level: Array, rate_Hz: float, extensions: Sequence[Extension] = (), *, min_rows: int = 0
) -> Samples:
    """Return the rows that depend on the instant of an isolated step within its sample.

        n = max(min_rows, 8 Q rate / (pi f))    rows after a step, for a mode with f > rate / 10

    level     (samples,)  drive, scaled to -1 .. 1
    min_rows  minimum number of rows after every step
    returned  (rows,)     in order
    """
    count = min_rows
    for mode in extensions:
        if isinstance(mode, LinearMode) and mode.frequency_Hz > RESOLVED * rate_Hz:
            decay_s = DECAY_TIMES * mode.quality / (pi * mode.frequency_Hz)
            count = max(count, ceil(decay_s * rate_Hz))
    rows = np.unique(isolated_steps(level)[:, None] + 1 + np.arange(count))
    return np.asarray(rows[rows < len(level)], dtype=np.intp)
