"""Prepare time stamps: unwrap counters that overflow, and find changes of the sampling rate."""

import itertools

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array

_BITS = (16, 24, 32)
_TICKS_s = (1e-3, 1e-6)  # of counters whose column is in another unit
_MAX_MISS = 2.5  # intervals between a stamp at an overflow and the end of the counter

# The interval is taken over BLOCK_STEPS, and a stretch lasts at least three blocks: the median of
# 64 steps that jitter by a third of themselves is certain to 8 %, and single blocks that a gap or
# a stall has spoilt are outvoted by their neighbours.
_BLOCK_STEPS = 64
_MIN_BLOCKS = 3
# Recorders change their rate by factors. Intervals of one clock that jitters by a third differ by
# less than this between two blocks; slower changes are left to the clock, which refuses them.
_MIN_RATE_CHANGE = 1.5
# Printed so coarsely (share of the interval), a block's span tells the interval, not single steps.
_COARSE_PRINT = 0.2


def unwrap_counter(time_s: Array, factor: float) -> tuple[Array, NDArray[np.intp], int]:
    """Return stamps that continue where a counter of 16, 24 or 32 bits overflowed.

        t_k <- t_k + 2^bits * tick * (overflows up to k)

    time_s    (rows,)  s, NaN kept
    factor    seconds of one unit of the column, one of the ticks that are tried
    returned  stamps, the rows at which it overflowed, and its bits; unchanged, none and 0 where
              no counter explains every step back

    The last stamp before an overflow must lie at the end of the counter and the next one at its
    beginning, 0 or the lowest signed number: a clock that was set back is no counter.
    """
    stamped = np.flatnonzero(np.isfinite(time_s))
    steps = np.diff(time_s[stamped])
    back = np.flatnonzero(steps < 0)
    interval_s = float(np.median(steps)) if len(steps) else 0.0
    if len(back) and interval_s > 0:
        last_s, first_s = time_s[stamped[back]], time_s[stamped[back + 1]]
        max_miss_s = _MAX_MISS * interval_s
        for tick_s, bits in itertools.product((factor, *_TICKS_s), _BITS):
            period_s = 2.0**bits * tick_s
            continues = np.abs(steps[back] + period_s - interval_s) < max_miss_s
            for low_s in (0.0, -period_s / 2):
                begins = np.abs(first_s - low_s) < max_miss_s
                ends = np.abs(last_s - low_s - period_s) < max_miss_s
                if (continues & begins & ends).all():
                    rows = stamped[back + 1]
                    overflows = np.zeros(len(time_s))
                    overflows[rows] = period_s
                    return time_s + np.cumsum(overflows), rows, bits
    return time_s, np.zeros(0, dtype=np.intp), 0


def stretches_of_one_rate(time_s: Array, resolution_s: float) -> tuple[slice, ...]:
    """Cut stamps where the sampling rate changes for good; one slice where it never does.

    time_s        (samples,)  s, finite
    resolution_s  to which the stamps were printed, 0 for full precision
    returned      adjacent slices that together hold every sample
    """
    steps = np.diff(time_s)
    blocks = len(steps) // _BLOCK_STEPS
    if blocks < 2 * _MIN_BLOCKS:
        return (slice(0, len(time_s)),)
    in_blocks = steps[: blocks * _BLOCK_STEPS].reshape(blocks, _BLOCK_STEPS)
    intervals_s = np.median(in_blocks, axis=1)
    if resolution_s > _COARSE_PRINT * np.median(intervals_s):
        intervals_s = in_blocks.mean(axis=1)
    padded = np.concatenate([intervals_s[:1], intervals_s, intervals_s[-1:]])
    intervals_s = np.median(np.lib.stride_tricks.sliding_window_view(padded, 3), axis=1)
    if not (intervals_s > 0).all():
        return (slice(0, len(time_s)),)
    edges = [
        _exact_edge(steps, block, intervals_s[block - 1], intervals_s[block]) + 1
        for block in _rate_changes(np.log(intervals_s))
    ]
    return tuple(slice(a, b) for a, b in itertools.pairwise((0, *edges, len(time_s))))


def _rate_changes(log_intervals: Array) -> list[int]:
    """Return the first block of each further stretch whose interval differs and stays so."""
    changes: list[int] = []
    min_change = np.log(_MIN_RATE_CHANGE)
    if np.ptp(log_intervals) <= min_change:
        return changes
    begin = 0
    for block in range(1, len(log_intervals) - _MIN_BLOCKS + 1):
        after = log_intervals[block : block + _MIN_BLOCKS] - np.median(log_intervals[begin:block])
        is_lasting = np.ptp(after) < min_change / 2
        if block - begin >= _MIN_BLOCKS and is_lasting and abs(after[0]) > min_change:
            changes.append(block)
            begin = block
    return changes


def _exact_edge(steps: Array, block: int, before_s: float, after_s: float) -> int:
    """Return the first step that fits the interval after the change better than the one before."""
    first = max((block - 2) * _BLOCK_STEPS, 0)
    near_s = steps[first : min((block + 2) * _BLOCK_STEPS, len(steps))]
    log_step = np.log(np.maximum(near_s, 1e-9 * min(before_s, after_s)))
    misfit = np.abs(log_step - np.log(before_s)) - np.abs(log_step - np.log(after_s))
    # The change is where the steps that fit the earlier interval end, counted from both sides.
    return first + int(np.argmin(np.concatenate([[0.0], np.cumsum(misfit)])))
