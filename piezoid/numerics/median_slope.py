"""The median of the slopes of all pairs, without making the pairs.

Slopes below t are pairs whose order turns round in y - t x: counted in n log n by Knight (1966).
Any slope by its rank is then found by trying slopes [Cole, Salowe, Steiger & Szemeredi 1989].
"""

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.numerics.quantiles import NORMAL_95

EXACT = 1000  # samples up to which scipy makes the pairs: half a million of them
GUESSED = 500  # samples from which a rank is guessed
CLOSE = 1e-6  # of the width of the interval, between the ends of what is told
TRIES = 200


def inversions(values: Array) -> int:
    """Return of how many pairs the later one is smaller.

    Ranks are split by their bits, the highest first; in a group of equal higher bits every zero
    behind a one is a pair.
    """
    count = len(values)
    rank = np.empty(count, dtype=np.int64)
    rank[np.argsort(values, kind="stable")] = np.arange(count)
    total, place = 0, np.arange(count)
    for bit in range(max(count - 1, 1).bit_length() - 1, -1, -1):
        start = (rank >> (bit + 1)) << (bit + 1)
        ones = (rank >> bit) & 1
        before = np.cumsum(ones) - ones
        before -= before[start]
        total += int(before @ (1 - ones))
        moved = np.where(ones == 1, start + (1 << bit) + before, place - before)
        split = np.empty_like(rank)
        split[moved] = rank
        rank = split
    return total


def median_slope(x: Array, y: Array) -> tuple[float, float, float]:
    """Return the median slope of y over x, and its 95 % interval [Theil 1950, Sen 1968].

    x, y  (samples,)  finite, x not constant

    Exact up to ``EXACT`` samples, beyond that to ``CLOSE`` of the interval's width.
    """
    from scipy.stats import theilslopes

    if len(x) <= EXACT:
        exact = theilslopes(y, x, alpha=0.95)
        return float(exact.slope), float(exact.low_slope), float(exact.high_slope)
    order = np.lexsort((y, x))
    x, y = x[order], y[order]
    pairs = _pairs(np.array([len(x)])) - _pairs(_repeated(x))
    half = 0.5 * NORMAL_95 * np.sqrt(_variance(x, y))
    rough = _some_slopes(x, y)
    ranks = np.clip(0.5 * pairs + np.array([0.0, -half, half]), 0.0, pairs)
    guess = np.quantile(rough, ranks / pairs)
    step = max(float(np.ptp(guess)), float(np.ptp(rough)) * CLOSE, np.finfo(float).tiny)
    low, slope, high = sorted(  # of slopes that all are alike the ends may meet beyond the middle
        _slope_of_rank(x, y, rank, near, step)
        for rank, near in zip(ranks.tolist(), guess.tolist(), strict=True)
    )
    return slope, low, high


def _repeated(values: Array) -> NDArray[np.int64]:
    """Return how often each value stands there."""
    return np.unique(values, return_counts=True)[1]


def _pairs(counts: NDArray[np.int64]) -> int:
    """Return how many pairs groups of so many make."""
    return int(np.sum(counts * (counts - 1)) // 2)


def _variance(x: Array, y: Array) -> float:
    """Return the variance of Kendall's score with ties [Sen 1968]."""
    whole, *tied = (
        float(np.sum(k * (k - 1.0) * (2.0 * k + 5.0)))
        for k in (np.array([len(x)]), _repeated(x), _repeated(y))
    )
    return (whole - sum(tied)) / 18.0


def _some_slopes(x: Array, y: Array) -> Array:
    """Return the slopes of all pairs of some samples, evenly taken."""
    some = np.linspace(0, len(x) - 1, GUESSED).astype(int)
    first, second = np.triu_indices(GUESSED, 1)
    across, up = (v[some][second] - v[some][first] for v in (x, y))
    return np.asarray(up[across > 0.0] / across[across > 0.0])


def _slope_of_rank(x: Array, y: Array, rank: float, near: float, step: float) -> float:
    """Return the slope below which so many lie, by trying lines between two that enclose it."""

    def beyond(slope: float) -> float:
        return inversions(y - slope * x) - rank

    low, high = near - step, near + step
    below, above = beyond(low), beyond(high)
    while below > 0.0:
        low, below = low - 2.0 * (high - low), beyond(low - 2.0 * (high - low))
    while above < 0.0:
        high, above = high + 2.0 * (high - low), beyond(high + 2.0 * (high - low))
    for tried in range(TRIES):
        if high - low <= CLOSE * step or below == above:
            break
        # A line between the ends; every third time the middle, so that both ends close in.
        share = 0.5 if tried % 3 == 2 else float(np.clip(-below / (above - below), 0.01, 0.99))
        middle = low + share * (high - low)
        found = beyond(middle)
        low, below, high, above = (
            (middle, found, high, above) if found < 0.0 else (low, below, middle, found)
        )
    return 0.5 * (low + high)
