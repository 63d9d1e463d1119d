"""Curves with few points: the fewest that stay within a tolerance, and envelopes over time."""

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array

MOST = 50_000  # samples that are worth splitting one by one
Places = NDArray[np.int_]
Chord = tuple[int, int]
"""The places of its ends."""
Worst = tuple[float, int]
"""Minus the largest distance from a chord, and where."""


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
    chords = _chords(x[places], y[places], tolerance)
    kept, whole = {0, len(places) - 1}, (0, len(places) - 1)
    waiting = [(*chords[whole], *whole)]
    while waiting and len(kept) < points and -waiting[0][0] > tolerance:
        _, middle, first, last = heapq.heappop(waiting)
        kept.add(middle)
        for part in ((first, middle), (middle, last)):
            if part in chords:
                heapq.heappush(waiting, (*chords[part], *part))
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


def _chords(x: Array, y: Array, tolerance: float) -> dict[Chord, Worst]:
    """Return every chord that splitting can come to, with its worst point.

    Where a chord is split does not depend on when: all that are split together are looked at
    together, thousands of short ones at once.
    """
    first, last = np.array([0]), np.array([len(x) - 1])
    found: dict[Chord, Worst] = {(0, len(x) - 1): (0.0, 0)}
    while True:
        inside = last - first > 1
        first, last = first[inside], last[inside]
        if not len(first):
            return found
        far, middle = _worst(x, y, first, last)
        chords = zip(first.tolist(), last.tolist(), strict=True)
        found |= zip(chords, zip((-far).tolist(), middle.tolist(), strict=True), strict=True)
        split = far > tolerance
        edges = np.stack([first[split], middle[split], last[split]], axis=1)
        first, last = edges[:, :2].ravel(), edges[:, 1:].ravel()


def _worst(x: Array, y: Array, first: Places, last: Places) -> tuple[Array, Places]:
    """Return the largest distance from each chord, and where; chords follow one another."""
    counts = last - first - 1
    begins = np.cumsum(counts) - counts
    chord = np.repeat(np.arange(len(first)), counts)
    place = np.arange(len(chord)) + (first + 1 - begins)[chord]
    a, b = x[place] - x[first][chord], y[place] - y[first][chord]
    across, up = (x[last] - x[first])[chord], (y[last] - y[first])[chord]
    length = across * across + up * up
    share = (a * across + b * up) / np.where(length > 0, length, 1.0)
    along = np.minimum(np.maximum(share, 0.0), 1.0)
    distance = np.hypot(a - along * across, b - along * up)
    far = np.maximum.reduceat(distance, begins)
    is_far = np.flatnonzero(distance == far[chord])
    return far, place[is_far[np.searchsorted(is_far, begins)]]


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
