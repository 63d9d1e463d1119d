"""Statistics of a batch: compared quantities, their spread, outliers and trends.

The thresholds are corrected for the number of tests.
"""

from array import array
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.design.design import AxisDesign
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import (
    Spread,
    Trend,
    deviations,
    holm,
    normal_quantile,
    spread_beyond,
    spread_of,
    trend_of,
)
from piezoid_reports.fleet.records import Fleet

MIN_STAGES = 5  # for a spread
# The spread of few stages is uncertain. Widening the limit by a factor of 1 + 12 / number keeps
# the false alarms of normal samples of 5 to 200 stages below FALSE_ALARMS (tested).
WIDENING = 12.0
FALSE_ALARMS = 0.5  # expected outliers in a batch without faults
TREND_P = 0.01


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One number of an axis that is compared between stages.

    name    in JSON and Parquet, ending with its unit
    label   on the page
    unit    SI
    of      computes the number from an axis and its design, or None without one
    cause   possible causes of an outlier
    error   computes its standard error, or None if unknown
    ratio   stages are compared by ratio and not by difference: quantities that cannot fall below
            zero have a long tail upwards
    """

    name: str
    label: str
    unit: str
    of: Callable[[AxisModel, AxisDesign | None], float | None]
    cause: str
    error: Callable[[AxisModel], float | None] = lambda _: None
    ratio: bool = False


def _sensitivity(axis: AxisModel, _: AxisDesign | None) -> float | None:
    loading_m, reach_V = axis.uncertainty.loading_m[-1], axis.uncertainty.reach_V[-1]
    return float(loading_m / reach_V) if reach_V > 0.0 else None


def _sensitivity_error(axis: AxisModel) -> float | None:
    reach_V = float(axis.uncertainty.reach_V[-1])
    half_m = float(axis.uncertainty.loading_half_m[-1])
    return half_m / reach_V / axis.uncertainty.coverage if reach_V > 0.0 else None


QUANTITIES = (
    Quantity(
        name="sensitivity_m_per_V",
        label="sensitivity",
        unit="m/V",
        of=_sensitivity,
        error=_sensitivity_error,
        cause="another ceramic, a cracked stack, a wrong preload, a wrong sensor gain",
    ),
    Quantity(
        name="loop_width_percent",
        label="loop width, of the range",
        unit="%",
        of=lambda axis, _: 100.0 * axis.uncertainty.loop_width_m[0] / axis.quality.range_m,
        error=lambda axis: (
            100.0
            * axis.uncertainty.loop_width_m[1]
            / axis.quality.range_m
            / axis.uncertainty.coverage
        ),
        cause="another ceramic, a depoled stack, friction, or a lag that looks like hysteresis",
    ),
    Quantity(
        name="held_out_rms_percent",
        label="held-out error, of the range",
        unit="%",
        of=lambda axis, _: axis.quality.held_out_rms_percent,
        cause="an effect outside the model: read the diagnosis of that stage",
        ratio=True,
    ),
    Quantity(
        name="noise_rms_m",
        label="sensor noise",
        unit="m",
        of=lambda axis, _: axis.quality.noise_rms_m,
        cause="a misaligned sensor, a cable, a ground loop",
        ratio=True,
    ),
    Quantity(
        name="lag_s",
        label="lag beyond the declared poles",
        unit="s",
        of=lambda axis, _: axis.lag.time_s,
        error=lambda axis: axis.uncertainty.standard_error("lag_s"),
        cause="an undeclared filter, another capacitance, channels sampled at different times",
    ),
    Quantity(
        name="error_bound_m",
        label="certified error bound",
        unit="m",
        of=lambda axis, _: axis.certificate.bound_m,
        cause="too little data of that stage, or a large residual",
        ratio=True,
    ),
    Quantity(
        name="bandwidth_Hz",
        label="closed-loop bandwidth",
        unit="Hz",
        of=lambda _, design: None if design is None else design.recommended.bandwidth_Hz,
        cause="a mode or a delay that limits only this stage",
    ),
    Quantity(
        name="modulus_margin",
        label="modulus margin, worst member",
        unit="",
        of=lambda _, design: None if design is None else design.recommended.worst_modulus_margin,
        cause="a wider plant family than that of the other stages",
    ),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """One quantity of one axis for all stages that have it, its outliers, and its trend.

    stages     (count,)  names
    serials    (count,)  NaN if a name contains no number
    values     (count,)  SI
    errors     (count,)  standard errors of the values; 0 if unknown
    spread     of the values
    deviation  (count,)  from the median or a significant trend, in standard deviations: robust
               spread of the stages and standard error of the value combined; of the logarithm for
               quantities compared by ratio
    limit      deviation above which a stage is an outlier
    normal     lowest and highest value of a stage with median standard error within the limit
    trend      over serial numbers
    trend_p    p-value of the trend, corrected for the number of quantities
    """

    axis: str
    quantity: Quantity
    stages: tuple[str, ...]
    serials: Array
    values: Array
    errors: Array
    spread: Spread
    deviation: Array
    limit: float
    normal: tuple[float, float]
    trend: Trend | None
    trend_p: float

    @property
    def drifts(self) -> bool:
        """Whether the trend is significant."""
        return self.trend is not None and self.trend_p < TREND_P

    @property
    def outliers(self) -> tuple[int, ...]:
        """Indices of the outliers, largest deviation first."""
        outliers = np.flatnonzero(np.abs(self.deviation) > self.limit)
        return tuple(
            int(k) for k in outliers[np.argsort(-np.abs(self.deviation[outliers]), kind="stable")]
        )


def compare_stages(fleet: Fleet) -> tuple[Distribution, ...]:
    """Return every quantity that at least ``MIN_STAGES`` stages have, axis by axis."""
    names: list[str] = []
    numbers = array("d")
    # Stage, value and error of each quantity of an axis: 20 bytes per stage.
    columns: defaultdict[tuple[str, str], tuple[array[int], array[float], array[float]]]
    columns = defaultdict(lambda: (array("l"), array("d"), array("d")))
    for index, stage in enumerate(fleet.stages):
        names.append(stage.name)
        numbers.append(np.nan if stage.serial is None else float(stage.serial))
        for axis in stage.axes:
            for name, value in axis.values.items() if axis.applies else ():
                indices, values, errors = columns[axis.axis, name]
                indices.append(index)
                values.append(value)
                errors.append(axis.errors.get(name, 0.0))
    all_names, all_serials = tuple(names), np.array(numbers)
    compared = [
        (axis_name, quantity, *columns[axis_name, quantity.name])
        for axis_name in sorted({axis for axis, _ in columns})
        for quantity in QUANTITIES
        if len(columns[axis_name, quantity.name][0]) >= MIN_STAGES
    ]
    n_tests = sum(len(values) for *_, values, _ in compared)
    limit = float(-normal_quantile(FALSE_ALARMS / max(n_tests, 1) / 2))
    trends = [
        trend_of(all_serials[np.array(indices)], np.array(values))
        for _, _, indices, values, _ in compared
    ]
    p_values = holm(np.array([1.0 if trend is None else trend.p_value for trend in trends]))
    distributions = []
    for row, trend, p in zip(compared, trends, p_values, strict=True):
        axis_name, quantity, indices, values, errors = row
        is_complete = len(indices) == len(all_names)
        stages = all_names if is_complete else tuple(all_names[k] for k in indices)
        serials = all_serials if is_complete else all_serials[np.array(indices)]
        series = serials, np.array(values), np.array(errors)
        distributions.append(
            _distribution(axis_name, quantity, stages, series, limit, trend, float(p))
        )
    return tuple(distributions)


def _distribution(
    axis: str,
    quantity: Quantity,
    stages: tuple[str, ...],
    series: tuple[Array, Array, Array],
    limit: float,
    trend: Trend | None,
    p_value: float,
) -> Distribution:
    """Return the outliers of one quantity; ``series`` are serial numbers, values and errors."""
    serials, values, errors = series
    drifts = trend is not None and p_value < TREND_P
    level = values - trend.slope * (serials - trend.about) if trend and drifts else values
    ratio = quantity.ratio and level.min() > 0.0
    scaled, scaled_errors = (np.log(level), errors / level) if ratio else (level, errors)
    scaled_spread = spread_beyond(scaled, scaled_errors)
    widened_limit = limit * (1.0 + WIDENING / len(values))
    typical_sigma = float(np.hypot(scaled_spread.sigma, np.median(scaled_errors)))
    limits = scaled_spread.median + widened_limit * typical_sigma * np.array([-1.0, 1.0])
    low, high = np.exp(limits) if ratio else limits
    return Distribution(
        axis=axis,
        quantity=quantity,
        stages=stages,
        serials=serials,
        values=values,
        errors=errors,
        spread=spread_of(values),
        deviation=deviations(scaled, scaled_spread, scaled_errors),
        limit=widened_limit,
        normal=(float(low), float(high)),
        trend=trend,
        trend_p=p_value,
    )
