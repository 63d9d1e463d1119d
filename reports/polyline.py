"""Curves with few points: the fewest that stay within a tolerance, and envelopes over time."""

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array

MOST = 50_000  # samples that are worth splitting one by one
Places = NDArray[np.int_]


def thinned(x: Array, y: Array, *, tolerance: float, points: int) -> tuple[Places, float]:
    """Choose the points of a polyline that stays close to a curve.

    The chord that is worst is split at its worst point, until none is worse than the tolerance or
    the points are spent (Douglas and Peucker 1973, in order of need).

    x, y       (samples,)  in the same unit
    tolerance  distance that nobody sees
    points     the most that may be kept
    returned   (kept,) places, and the largest distance of what was left out
    """
    places, cell = _moving(x, y, 0.5 * tolerance)
    x, y = x[places], y[places]
    kept = {0, len(x) - 1}
    waiting = [_worst(x, y, 0, len(x) - 1)]
    while waiting and len(kept) < points and -waiting[0][0] > tolerance:
        _, middle, first, last = heapq.heappop(waiting)
        kept.add(middle)
        for part in ((first, middle), (middle, last)):
            if part[1] - part[0] > 1:
                heapq.heappush(waiting, _worst(x, y, *part))
    left = max(-waiting[0][0], 0.0) if waiting else 0.0
    return places[sorted(kept)], float(left + math.sqrt(2.0) * cell)


def _moving(x: Array, y: Array, cell: float) -> tuple[Places, float]:
    """Return the samples at which the curve enters another cell, and the size of the cells.

    Cells grow until few enough samples are left to be split in a moment.
    """
    while True:
        number = np.floor(np.stack([x, y]) / cell)
        moved = np.any(np.diff(number, axis=1) != 0.0, axis=0)
        if moved.sum() <= MOST:
            return np.unique(np.concatenate([[0], 1 + np.flatnonzero(moved), [len(x) - 1]])), cell
        cell *= 2.0


def _worst(x: Array, y: Array, first: int, last: int) -> tuple[float, int, int, int]:
    """Return (minus the largest distance from the chord, where, and the chord itself)."""
    if last - first < 2:
        return 0.0, first, first, last
    a, b = x[first + 1 : last] - x[first], y[first + 1 : last] - y[first]
    across, up = x[last] - x[first], y[last] - y[first]
    length = across * across + up * up
    if length > 0:
        along = np.minimum(np.maximum((a * across + b * up) / length, 0.0), 1.0)
        distance = np.hypot(a - along * across, b - along * up)
    else:
        distance = np.hypot(a, b)
    place = int(distance.argmax())
    return -float(distance[place]), first + 1 + place, first, last


def envelope(x: Array, y: Array, bins: int) -> tuple[Array, Array, Array]:
    """Return the middle of every bin of x, and the least and greatest y in it, without empty bins.

    x  (samples,)  not decreasing
    """
    edges = np.linspace(x[0], x[-1], bins + 1)
    first = np.unique(np.searchsorted(x, edges[:-1], side="left"))
    first = first[first < len(x)]
    last = np.append(first[1:], len(x))
    middle = (x[first] + x[last - 1]) / 2
    return middle, np.minimum.reduceat(y, first), np.maximum.reduceat(y, first)


def whole_parts(y: Array) -> list[slice]:
    """Return the stretches of at least two samples without NaN."""
    good = np.concatenate([[False], np.isfinite(y), [False]])
    edges = np.flatnonzero(np.diff(good.astype(int)))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]
