"""Statistics of many samples that one broken sample cannot move: middle, spread, trend."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array

# A normal distribution's standard deviation over its median absolute deviation.
_MAD_TO_SIGMA = 1.4826022185056018
# Where more than half of the values are equal, the deviation is taken from the mean instead
# [Iglewicz & Hoaglin 1993].
_MEAN_TO_SIGMA = 1.2533141373155003


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


def deviations(values: Array, spread: Spread) -> Array:
    """Return how many sigma each value lies from the middle, signed; 0 where nothing varies."""
    if spread.sigma == 0.0:
        return np.where(np.isfinite(values), 0.0, np.nan)
    return np.asarray((values - spread.median) / spread.sigma)


def trend_of(x: Array, y: Array) -> Trend | None:
    """Return the trend of y over x, or None for fewer than eight pairs or a constant one.

    x, y  (samples,)  pairs with a NaN are left out
    """
    from scipy.stats import kendalltau, theilslopes

    both = np.isfinite(x) & np.isfinite(y)
    x, y = x[both], y[both]
    if len(x) < 8 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return None
    found = theilslopes(y, x, alpha=0.95)
    return Trend(
        slope=float(found.slope),
        ci95=(float(found.low_slope), float(found.high_slope)),
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
