"""Robust statistics of samples: median, spread, trend and noise, insensitive to gross errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit

from piezoid.numerics.arrays import Array

NORMAL_95 = 1.959963984540054  # half the width of the 95 % interval of a standard normal variable

# The slopes of all pairs of n samples take 8 n^2 bytes of memory: 8 MB for 1000 samples.
MAX_PAIRED_SAMPLES = 1000

# Standard deviation of a normal distribution over its median absolute deviation.
_MAD_TO_SIGMA = 1.4826022185056018
# The same over its mean absolute deviation [Iglewicz & Hoaglin 1993].
_MEAN_TO_SIGMA = 1.2533141373155003
# Rms of third differences of white noise of rms 1, and the median of |x| for a standard normal x.
_THIRD = float(np.sqrt(20.0))
_MEDIAN = 0.6744897501960817
_TINY = 1e-300


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Median and spread of a sample.

    count       number of finite values
    median      their median
    sigma       standard deviation of a normal distribution with the same median deviation
    low, high   the 5 % and the 95 % quantile
    """

    count: int
    median: float
    sigma: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Trend:
    """Linear trend of one quantity along another.

    slope     median of the slopes of all pairs [Theil 1950, Sen 1968]
    ci95      its 95 % interval
    middle    median ordinate: value of the line at the median abscissa
    about     median abscissa
    p_value   of the hypothesis of no trend, by Kendall's tau
    """

    slope: float
    ci95: tuple[float, float]
    middle: float
    about: float
    p_value: float


def spread_of(values: Array) -> Spread:
    """Return median, spread and quantiles of the finite values.

        sigma = 1.4826 median |x - median x|

    If more than half of the values are equal, the mean deviation replaces the median deviation.

    values  (samples,)  at least one finite
    """
    finite = values[np.isfinite(values)]
    median = float(np.median(finite))
    deviation = np.abs(finite - median)
    sigma = _MAD_TO_SIGMA * float(np.median(deviation))
    if sigma == 0.0:
        sigma = _MEAN_TO_SIGMA * float(np.mean(deviation))
    low, high = np.quantile(finite, (0.05, 0.95))
    return Spread(count=len(finite), median=median, sigma=sigma, low=float(low), high=float(high))


def spread_beyond(values: Array, errors: Array) -> Spread:
    """Return the spread of values beyond their standard errors.

        median |x - m| / sqrt(sigma^2 + e^2) = 1 / 1.4826

    with m the median of the values weighted by 1 / sqrt(sigma^2 + e^2).

    values  (samples,)  finite
    errors  (samples,)  their standard errors; all 0: ``spread_of`` the values

    The random-effects model of [DerSimonian & Laird 1986] with medians in place of means. Sigma is
    0 where the errors alone explain the scatter.
    """
    scatter = spread_of(values)
    if not errors.any():
        return scatter
    from scipy.optimize import bisect

    low, high = 0.0, 2.0 * float(np.abs(values - scatter.median).max())
    if _weighted_spread(values, errors, low)[1] > 1.0:
        low = float(bisect(lambda s: _weighted_spread(values, errors, s)[1] - 1.0, low, high))
    median, _ = _weighted_spread(values, errors, low)
    return replace(scatter, median=median, sigma=low)


def _weighted_spread(values: Array, errors: Array, sigma: float) -> tuple[float, float]:
    """Return the weighted median, and the scatter about it over the expected one."""
    # An error of 0 is replaced by the smallest positive error, so that sigma may be 0.
    expected = np.sqrt(sigma**2 + np.maximum(errors, errors[errors > 0.0].min()) ** 2)
    order = np.argsort(values, kind="stable")
    weight = np.cumsum(1.0 / expected[order])
    median = float(values[order][np.searchsorted(weight, 0.5 * weight[-1])])
    return median, _MAD_TO_SIGMA * float(np.median(np.abs(values - median) / expected))


def deviations(values: Array, spread: Spread, errors: Array | None = None) -> Array:
    """Return the signed distance of each value from the median, in sigma; 0 for constant values.

    errors  (samples,)  standard errors of the values, added to sigma in quadrature
    """
    sigma = np.hypot(spread.sigma, np.zeros(len(values)) if errors is None else errors)
    scaled = np.divide(values - spread.median, sigma, out=np.zeros(len(values)), where=sigma > 0.0)
    return np.where(np.isfinite(values), scaled, np.nan)


def trend_of(x: Array, y: Array) -> Trend | None:
    """Return the trend of y over x; None for fewer than eight pairs or a constant x or y.

    x, y  (samples,)  pairs with a NaN are left out

    The slope of more than ``MAX_PAIRED_SAMPLES`` samples is that of as many samples, evenly
    spaced along x; the p-value uses all of them.
    """
    from scipy.stats import kendalltau, theilslopes

    finite = np.isfinite(x) & np.isfinite(y)
    order = np.lexsort((y[finite], x[finite]))
    x, y = x[finite][order], y[finite][order]
    if len(x) < 8 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return None
    paired = np.unique(np.linspace(0, len(x) - 1, MAX_PAIRED_SAMPLES).astype(int))
    line = theilslopes(y[paired], x[paired], alpha=0.95)
    return Trend(
        slope=float(line.slope),
        ci95=(float(line.low_slope), float(line.high_slope)),
        middle=float(np.median(y)),
        about=float(np.median(x)),
        p_value=float(kendalltau(x, y).pvalue),
    )


def holm(p_values: Array) -> Array:
    """Return p-values adjusted for the number of tests [Holm 1979]."""
    order = np.argsort(p_values, kind="stable")
    count = len(p_values)
    stepped = np.maximum.accumulate(p_values[order] * (count - np.arange(count)))
    adjusted = np.empty(count)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


def normal_quantile(probability: ArrayLike) -> Array:
    """Return quantiles of the standard normal distribution."""
    return np.asarray(ndtri(probability))


def student_quantile(probability: ArrayLike, freedom: ArrayLike) -> Array:
    """Return quantiles of Student's t distribution.

    probability  (...)  0 to 1
    freedom      (...)  degrees of freedom, > 0; infinite: the normal distribution
    """
    is_normal = np.isinf(freedom)
    student = stdtrit(np.where(is_normal, 1.0, freedom), probability)
    return np.asarray(np.where(is_normal, ndtri(probability), student))


def jackknife_half(replicates: Array) -> Array:
    """Return half the 95 % interval of a jackknife, (values,) [Tukey 1958]; infinite for one.

    replicates  (replicates, values)  each estimated without one block of the data
    """
    count = len(replicates)
    if count < 2:
        return np.full(replicates.shape[1], np.inf)
    spread = ((replicates - replicates.mean(axis=0)) ** 2).sum(axis=0)
    quantile = float(student_quantile(0.975, count - 1))
    return np.asarray(quantile * np.sqrt((count - 1) / count * spread))


def sandwich_covariance(curvature: Array, scatters: Sequence[Array], factor: float = 1.0) -> Array:
    """Return the covariance of a fit: inverse curvature, widened by sandwiches [White 1982].

        factor C^-1,   C^-1 M C^-1

    Each variance is the largest of these. Directions without curvature have no variance.

    C  curvature  (numbers, numbers)
    M  scatters   (numbers, numbers) each: sums of outer products of independent scores
    """
    scale = np.sqrt(np.maximum(np.diag(curvature), _TINY))
    inverse = np.linalg.pinv(curvature / np.outer(scale, scale), rcond=1e-14, hermitian=True)
    inverse /= np.outer(scale, scale)
    expected = factor * inverse
    variance = np.max([np.diag(inverse @ scatter @ inverse) for scatter in scatters], axis=0)
    stretch = np.sqrt(np.maximum(variance / np.maximum(np.diag(expected), _TINY), 1.0))
    return np.asarray(expected * np.outer(stretch, stretch))


def white_noise_rms(signal: Array, spacing: int = 1) -> float:
    """Return the rms of the white part of a slowly varying signal's noise.

    Third differences remove smooth motion; the median of their magnitude is robust to jumps and to
    the few samples at reversals.

    signal   (samples,)  any unit; differences with NaN are omitted; the result is 0 for fewer than
             ``8 * spacing`` samples
    spacing  number of samples between the values of a difference
    """
    if len(signal) < 8 * spacing:
        return 0.0
    third = signal
    for _ in range(3):
        third = third[spacing:] - third[:-spacing]
    finite = third[~np.isnan(third)]
    return float(np.median(np.abs(finite))) / (_MEDIAN * _THIRD) if len(finite) else 0.0
