"""Stretches of one sampling rate in a file that has several, told from its stamps alone."""

import itertools

import numpy as np

from piezoid.numerics.arrays import Array

# The interval is taken over so many steps, and a stretch lasts at least three times as long: the
# median of 64 steps that jitter by a third of themselves is sure to 8 %, and single blocks that a
# gap or a stall has spoilt are outvoted by their neighbours.
_BLOCK = 64
_LEAST_BLOCKS = 3
# Recorders change their rate by factors. Intervals of one clock that jitters by a third differ by
# less than this between two blocks; slower changes are left to the clock, which refuses them.
_CHANGE = 1.5
# Printed so coarsely, single steps do not tell the interval: then the span of a block does.
_COARSE = 0.2


def stretches_of_one_rate(time_s: Array, resolution_s: float) -> tuple[slice, ...]:
    """Cut stamps where the sampling rate changes for good; one slice where it never does.

    time_s        (samples,)  s, finite
    resolution_s  to which the stamps were printed, 0 for full precision
    returned      slices that lie behind each other and together hold every sample
    """
    whole = (slice(0, len(time_s)),)
    steps = np.diff(time_s)
    blocks = len(steps) // _BLOCK
    if blocks < 2 * _LEAST_BLOCKS:
        return whole
    intervals_s = _intervals_s(time_s, steps, blocks, resolution_s)
    if not (intervals_s > 0).all():
        return whole
    edges = _edges(np.log(intervals_s))
    if not edges:
        return whole
    inner = [_refined(steps, edge, intervals_s[edge - 1], intervals_s[edge]) + 1 for edge in edges]
    return tuple(slice(a, b) for a, b in itertools.pairwise((0, *inner, len(time_s))))


def _intervals_s(time_s: Array, steps: Array, blocks: int, resolution_s: float) -> Array:
    """Return the interval of each block, spoilt ones in the middle of their neighbours'."""
    cut = steps[: blocks * _BLOCK].reshape(blocks, _BLOCK)
    found = np.median(cut, axis=1)
    if resolution_s > _COARSE * np.median(found):
        found = np.diff(time_s[: blocks * _BLOCK + 1 : _BLOCK]) / _BLOCK
    padded = np.concatenate([found[:1], found, found[-1:]])
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 3), axis=1))


def _edges(levels: Array) -> list[int]:
    """Return the first block of each further stretch whose level is another one, and holds."""
    edges: list[int] = []
    if np.ptp(levels) <= np.log(_CHANGE):
        return edges
    begin = 0
    for block in range(1, len(levels) - _LEAST_BLOCKS + 1):
        before = np.median(levels[begin:block])
        after = levels[block : block + _LEAST_BLOCKS] - before
        holds = np.ptp(after) < np.log(_CHANGE) / 2
        if block - begin >= _LEAST_BLOCKS and holds and abs(after[0]) > np.log(_CHANGE):
            edges.append(block)
            begin = block
    return edges


def _refined(steps: Array, edge: int, before_s: float, after_s: float) -> int:
    """Return the first step that fits the interval after the change better than the one before."""
    first, last = max((edge - 2) * _BLOCK, 0), min((edge + 2) * _BLOCK, len(steps))
    near = np.log(np.maximum(steps[first:last], 1e-9 * min(before_s, after_s)))
    worse = np.abs(near - np.log(before_s)) - np.abs(near - np.log(after_s))
    # The change lies where the steps that fit the earlier interval end, counted from both sides.
    return first + int(np.argmin(np.concatenate([[0.0], np.cumsum(worse)])))
