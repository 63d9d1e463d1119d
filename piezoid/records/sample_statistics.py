"""Noise, converter step and clipping of a channel, estimated from its samples alone."""

import math

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array

# Samples: a clipped converter stays at its last code; noise and slope end other runs earlier.
_CLIPPED_RUN = 5
# By the parabola at its top, a coarsely converted sine stays at its last code up to
# 2 / (sqrt(2) - 1) = 4.8 times as long as at the one before it.
_CLIPPED_RATIO = 8
# A drive that jumps to its extreme was commanded to: in typical steps, or in shares of the span.
_JUMP = 5.0
_JUMP_SHARE = 0.2
# Noise by third over noise by second differences: 1.0 for white noise, 0.64 for a sine of a fifth
# of the sampling rate. Noise below the second constant, relative to the range, is not tested.
_MIN_WHITE = 0.8
_NOTICEABLE = 1e-3
# Blocks of white noise of 64 samples or more differ by less than a factor of 2; those of a chirp
# through a resonance differ by more.
_BLOCKS = 8
_MIN_BLOCK = 64
_MAX_UNEVEN = 4.0
MIN_MOTION_NOISE = 20.0  # standard deviations of the noise; a smaller range may be noise alone


def noise_rms(values: Array) -> float:
    """Return the rms of the white noise on a smooth signal, from its second differences.

    The second difference of white noise has six times its variance, that of a smooth signal is
    small, and the median suppresses jumps. A median of zero means noise below the converter step,
    whose rounding error is then returned: step / sqrt(12).
    """
    if len(values) < 5:
        return 0.0
    spread = robust_sigma(np.diff(values, 2))
    return spread / math.sqrt(6.0) if spread > 0 else step_size(values) / math.sqrt(12.0)


def is_noise_hidden(values: Array) -> bool:
    """Return whether a signal is so fast that ``noise_rms`` is that of the signal.

    The third difference of white noise has twenty times its variance, so that both differences
    give the same noise. For a sine of w radians per sample the ratio of the third to the second is
    2 sin(w / 2) sqrt(6 / 20). A signal that is fast in only one part of the record, as a chirp
    through a resonance, shows many times the noise of the other parts there.
    """
    second, third = (robust_sigma(np.diff(values, order)) for order in (2, 3))
    is_noticeable = second / math.sqrt(6.0) > _NOTICEABLE * float(np.ptp(values))
    if not is_noticeable:
        return False
    if third / math.sqrt(20.0) < _MIN_WHITE * second / math.sqrt(6.0):
        return True
    if len(values) < _BLOCKS * _MIN_BLOCK:
        return False
    blocks = [robust_sigma(np.diff(block, 2)) for block in np.array_split(values, _BLOCKS)]
    positive = [spread for spread in blocks if spread > 0.0]  # a frozen reading shows no noise
    quietest = min(positive, default=0.0)
    return max(blocks) > _MAX_UNEVEN * max(quietest, step_size(values))


def robust_sigma(values: Array) -> float:
    """Return the standard deviation of a normal distribution with the median deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def step_size(values: Array) -> float:
    """Return the smallest step of which all values are multiples, or 0.

    The step of values printed with few digits is the resolution of the print.
    """
    distinct = np.unique(values)
    if len(distinct) < 3 or 2 * len(distinct) > len(values):
        return 0.0
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-9 * max(abs(distinct[0]), abs(distinct[-1]))]
    if not len(gaps):
        return 0.0
    smallest = float(np.min(gaps))
    step = float(np.mean(gaps[gaps < 1.5 * smallest]))
    multiples = gaps / step
    fits = np.abs(multiples - np.round(multiples)) < 0.1
    return step if fits.mean() > 0.9 else 0.0


def runs_of_equal(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first sample of each run of equal values, and the sample behind its last one."""
    edges = np.flatnonzero(np.diff(values)) + 1
    return np.concatenate(([0], edges)), np.concatenate((edges, [len(values)]))


def clipped_samples(values: Array, *, idle_value: float | None = None) -> NDArray[np.bool_]:
    """Return which samples are clipped at the largest or smallest value, (samples,).

    idle_value  a value at which the channel may stay on purpose (0 V between two motions), or None

    Clipped samples reach the extreme without a jump, unlike a step, and stay there for at least
    five samples and eight times as long as at any other level, unlike a staircase.
    """
    is_clipped = np.zeros(len(values), dtype=bool)
    if len(values) < 4 * _CLIPPED_RUN or np.ptp(values) == 0:
        return is_clipped
    starts, stops = runs_of_equal(values)
    lengths, levels = stops - starts, values[starts]
    extreme = (levels == values.max()) | (levels == values.min())
    typical = float(np.median(np.abs(np.diff(levels))))
    # A constant value at either end may be the rest before or after the motion.
    inner = (starts > 0) & (stops < len(values))
    inner &= np.ones(len(starts), dtype=bool) if idle_value is None else levels != idle_value
    arrival = np.zeros(len(starts))
    arrival[1:] = np.abs(np.diff(levels))
    elsewhere = int(lengths[~extreme].max(initial=1))
    longest = max(_CLIPPED_RUN, _CLIPPED_RATIO * elsewhere)
    jump = np.minimum(_JUMP * typical, _JUMP_SHARE * np.ptp(values))
    for run in np.flatnonzero(extreme & inner & (lengths >= longest) & (arrival <= jump)).tolist():
        is_clipped[starts[run] : stops[run]] = True
    return is_clipped
