"""Where a sweep's current stands at the preamplifier's limit instead of following the gap.

Next to the surface an exponential falls from its largest value P to 0.9 P within a fixed share of
the height it needs from 0.9 P to 0.45 P,

    h(P to 0.9 P) / h(0.9 P to 0.45 P) = ln(1 / 0.9) / ln 2 = 0.152        whatever its decay,

and a clipped one within a far larger one, whether its readings repeat exactly or carry noise from
behind the clipping stage. Rows are counted instead of heights: noise of the current cannot move
them in height.
"""

import math

import numpy as np

from piezoid.numerics.arrays import Array

_SHOULDER = 0.9
_HALF = 0.5 * _SHOULDER
_EXPONENTIAL = math.log(1.0 / _SHOULDER) / math.log(1.0 / 0.5)
# 400 unclipped sweeps with 5 % noise and 3 % hysteresis: largest 2.4; clipped at half: 7.6.
_TOO_LONG = 3.0
_FEWEST = 5  # rows on a plateau of readings that differ
_REPEATED = 3  # neighbours in height with exactly the largest current: noise never does that
# Averaged over a row, a current with hum or noise touches the limit before its mean gets there.
_CLEAR = 0.8
_SMOOTHED = 5  # rows of the running median


def rows_at_limit(current_A: Array) -> int:
    """Return how many rows, counted from the lowest height, lie at the amplifier's limit.

    current_A  (rows,)  in order of the height, lowest first; of either polarity

    Zero where no plateau is seen, or no fall behind it to compare it with. Rows up to where the
    current falls to 0.8 of the limit count: part of their readings may have been cut.
    """
    if len(current_A) < 2 * _FEWEST:
        return 0
    nearest = current_A[: max(len(current_A) // 20, _FEWEST)]
    upright_A = math.copysign(1.0, float(np.median(nearest))) * current_A
    smooth_A = _running_median(upright_A)
    limit_A = float(np.median(upright_A[:_FEWEST]))
    if not limit_A > 0.0:
        return 0
    shoulder = _first_below(smooth_A, _SHOULDER * limit_A)
    half = _first_below(smooth_A, _HALF * limit_A)
    flat = shoulder > _TOO_LONG * _EXPONENTIAL * max(half - shoulder, 1)
    falls = half < len(current_A)
    if not (falls and (_repeats(upright_A) or (flat and shoulder >= _FEWEST))):
        return 0
    return _first_below(smooth_A, _CLEAR * limit_A)


def _first_below(current_A: Array, level_A: float) -> int:
    """The first row below a level; all rows where none is."""
    below = np.flatnonzero(current_A < level_A)
    return int(below[0]) if len(below) else len(current_A)


def _repeats(upright_A: Array) -> bool:
    at_limit = (upright_A >= upright_A.max()).astype(np.float64)
    runs = np.convolve(at_limit, np.ones(_REPEATED), mode="valid")
    return bool(np.any(runs >= _REPEATED)) and not bool(at_limit.all())


def _running_median(values: Array) -> Array:
    side = _SMOOTHED // 2
    padded = np.concatenate([np.full(side, values[0]), values, np.full(side, values[-1])])
    windows = np.lib.stride_tricks.sliding_window_view(padded, _SMOOTHED)
    return np.asarray(np.median(windows, axis=1))
