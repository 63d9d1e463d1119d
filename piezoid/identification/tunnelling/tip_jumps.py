"""Tip jumps: the current steps at one height because the tip changed, not the gap.

A jump is a step of the log current that its neighbourhood does not share. It is sought where the
current stands clear of the floor, by the medians on either side of each place, against the
spread of the same statistic everywhere else: a smooth misfit moves all places alike.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array

_SIDE = 5  # points on either side: a median of five survives two outliers
_MEDIAN_OF_SIDE = 0.536  # standard deviation of the median of five unit normals
_ALARM = 6.0  # robust standard deviations; the windows overlap, so their spread is uncertain
_SMALLEST_NEPERS = 0.05  # a jump below this moves no decay by a percent


@dataclass(frozen=True, kw_only=True)
class TipJump:
    """One step of the log current along a sweep.

    sweep     which of the fitted sweeps, from 0
    height_m  between the two points it lies between
    nepers    upwards in height positive
    """

    sweep: int
    height_m: float
    nepers: float


def find_jump(log_residual: Array, log_deviation: Array) -> tuple[int, float] | None:
    """Return the place and size of the most conspicuous step of one sweep, or None.

        t = (median after - median before) / its standard deviation from the noise model

    log_residual   (points,)  nepers, in order of height
    log_deviation  (points,)  standard deviation of each: noise over current
    returned       index of the first point after the step, and its size in nepers

    A jump also inflates the fitted noise, so the noise model only says how the noise *varies*
    along the sweep; its scale comes from the same statistic at all other places.
    """
    if len(log_residual) < 4 * _SIDE:
        return None
    medians = np.median(_windows(log_residual), axis=1)
    steps = medians[_SIDE:] - medians[:-_SIDE]
    variances = np.mean(_windows(log_deviation) ** 2, axis=1)
    noise = _MEDIAN_OF_SIDE * np.sqrt(variances[_SIDE:] + variances[:-_SIDE])
    relative = steps / np.maximum(noise, 1e-300)
    apart = np.abs(relative - np.median(relative))
    large = np.where(np.abs(steps) > _SMALLEST_NEPERS, apart, 0.0)
    place = int(np.argmax(large))
    if large[place] <= _ALARM * 1.4826 * float(np.median(apart)):
        return None
    return place + _SIDE, float(steps[place])


def _windows(values: Array) -> Array:
    windows: Array = np.lib.stride_tricks.sliding_window_view(values, _SIDE)
    return windows
