"""Statistics of many samples that one broken sample cannot move: middle, spread, trend."""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.median_slope import median_slope

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
