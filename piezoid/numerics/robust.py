"""Statistics of many samples that one broken sample cannot move: middle, spread, trend.

The median of the slopes of all pairs, without making the pairs.

Slopes below t are pairs whose order turns round in y - t x: counted in n log n by Knight (1966).
Any slope by its rank is then found by trying slopes [Cole, Salowe, Steiger & Szemeredi 1989].
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri, stdtrit

from piezoid.numerics.arrays import Array

NORMAL_95 = 1.959963984540054
"""Half the width of a 95 % interval of a normal distribution, in standard deviations."""

EXACT = 1000  # samples up to which scipy makes the pairs: half a million of them
GUESSED = 500  # samples from which a rank is guessed
CLOSE = 1e-6  # of the width of the interval, between the ends of what is told
TRIES = 200

# A normal distribution's standard deviation over its median absolute deviation.
_MAD_TO_SIGMA = 1.4826022185056018
# Where more than half of the values are equal, the deviation is taken from the mean instead
# [Iglewicz & Hoaglin 1993].
_MEAN_TO_SIGMA = 1.2533141373155003
_HALVINGS = 50


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Middle and width of a sample.

    count       how many values there were
    median      of them
    sigma       standard deviation a normal distribution of this median deviation would have
    low, high   the 5 % and the 95 % quantile
    """

    count: int
    median: float
    sigma: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Trend:
    """How a quantity goes along with another one.

    slope     median of the slopes of all pairs [Theil 1950, Sen 1968]
    ci95      its 95 % interval
    middle    value of the line at the median abscissa
    about     that abscissa
    p_value   of no trend, by Kendall's tau
    """

    slope: float
    ci95: tuple[float, float]
    middle: float
    about: float
    p_value: float


def spread_of(values: Array) -> Spread:
    """Return middle and width of the finite values.

        sigma = 1.4826 median |x - median x|

    values  (samples,)  at least one finite
    """
    held = values[np.isfinite(values)]
    median = float(np.median(held))
    away = np.abs(held - median)
    sigma = _MAD_TO_SIGMA * float(np.median(away))
    if sigma == 0.0:
        sigma = _MEAN_TO_SIGMA * float(np.mean(away))
    low, high = np.quantile(held, (0.05, 0.95))
    return Spread(count=len(held), median=median, sigma=sigma, low=float(low), high=float(high))


def spread_beyond(values: Array, errors: Array) -> Spread:
    """Return middle and width of what values scatter beyond their own errors.

        median |x - m| / sqrt(sigma^2 + e^2) = 1 / 1.4826,   m the median weighted by the same

    values  (samples,)  finite
    errors  (samples,)  their standard errors; all 0: the plain spread

    The random effects of [DerSimonian & Laird 1986] with a median for the mean. Where the errors
    alone explain the scatter, sigma is 0.
    """
    plain = spread_of(values)
    if not errors.any():
        return plain
    low, high = 0.0, 2.0 * float(np.abs(values - plain.median).max())
    if _scatter(values, errors, low)[1] > 1.0:
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            above = _scatter(values, errors, middle)[1] > 1.0
            low, high = (middle, high) if above else (low, middle)
    median, _ = _scatter(values, errors, low)
    return replace(plain, median=median, sigma=low)


def _scatter(values: Array, errors: Array, sigma: float) -> tuple[float, float]:
    """Return the weighted median, and how wide values scatter about it over what they should."""
    # Where sigma is 0 a value without an error counts as if it had the smallest that another has.
    known = np.sqrt(sigma**2 + np.maximum(errors, errors[errors > 0.0].min()) ** 2)
    order = np.argsort(values, kind="stable")
    weight = np.cumsum(1.0 / known[order])
    median = float(values[order][np.searchsorted(weight, 0.5 * weight[-1])])
    return median, _MAD_TO_SIGMA * float(np.median(np.abs(values - median) / known))


def deviations(values: Array, spread: Spread, errors: Array | None = None) -> Array:
    """Return how many sigma each value lies from the middle, signed; 0 where nothing varies.

    errors  (samples,)  of each value, which widen its own sigma
    """
    sigma = np.hypot(spread.sigma, np.zeros(len(values)) if errors is None else errors)
    away = np.divide(values - spread.median, sigma, out=np.zeros(len(values)), where=sigma > 0.0)
    return np.where(np.isfinite(values), away, np.nan)


def trend_of(x: Array, y: Array) -> Trend | None:
    """Return the trend of y over x, or None for fewer than eight pairs or a constant one.

    x, y  (samples,)  pairs with a NaN are left out
    """
    from scipy.stats import kendalltau

    both = np.isfinite(x) & np.isfinite(y)
    x, y = x[both], y[both]
    if len(x) < 8 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return None
    slope, low, high = median_slope(x, y)
    return Trend(
        slope=slope,
        ci95=(low, high),
        middle=float(np.median(y)),
        about=float(np.median(x)),
        p_value=float(kendalltau(x, y).pvalue),
    )


def holm(p_values: Array) -> Array:
    """Return p-values as they are after having looked that often [Holm 1979]."""
    order = np.argsort(p_values, kind="stable")
    count = len(p_values)
    stepped = np.maximum.accumulate(p_values[order] * (count - np.arange(count)))
    adjusted = np.empty(count)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


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


def normal_quantile(probability: ArrayLike) -> Array:
    """Return the values below which a standard normal one lies with these probabilities."""
    return np.asarray(ndtri(probability))


def student_quantile(probability: ArrayLike, freedom: ArrayLike) -> Array:
    """Return the values below which Student's t lies with these probabilities.

    probability  (...)  0 to 1
    freedom      (...)  degrees of freedom, > 0; infinite: the normal distribution
    """
    known = np.isinf(freedom)
    finite = stdtrit(np.where(known, 1.0, freedom), probability)
    return np.asarray(np.where(known, ndtri(probability), finite))
