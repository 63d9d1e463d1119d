"""Statistics of a batch: spread of every quantity, outliers, trends over serial numbers.

The thresholds are corrected for the number of tests.
"""

from array import array
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

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
from piezoid.record_json import fields_of
from piezoid_reports.fleet.quantities import QUANTITIES, Quantity
from piezoid_reports.fleet.records import Fleet

MIN_STAGES = 5  # for a spread
# The spread of few stages is uncertain. Widening the limit by a factor of 1 + 12 / number keeps
# the false alarms of normal samples of 5 to 200 stages below FALSE_ALARMS (tested).
WIDENING = 12.0
FALSE_ALARMS = 0.5  # expected outliers in a batch without faults
TREND_P = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class QuantityValues:
    """One quantity of one axis for all stages that have it.

    stages   (count,)  names
    serials  (count,)  NaN if a name contains no number
    values   (count,)  SI
    errors   (count,)  standard errors of the values; 0 if unknown
    """

    axis: str
    quantity: Quantity
    stages: tuple[str, ...]
    serials: Array
    values: Array
    errors: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution(QuantityValues):
    """The spread of a quantity, its outliers, and its trend.

    spread     of the values
    deviation  (count,)  from the median or a significant trend, in standard deviations: robust
               spread of the stages and standard error of the value combined; of the logarithm for
               quantities scaled_spread by ratio
    limit      deviation above which a stage is an outlier
    normal     lowest and highest value of a stage with median standard error within the limit
    trend      over serial numbers
    trend_p    p-value of the trend, corrected for the number of quantities
    """

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
    quantities = _quantities(fleet)
    n_tests = sum(len(q.values) for q in quantities)
    limit = float(-normal_quantile(FALSE_ALARMS / max(n_tests, 1) / 2))
    trends = [trend_of(q.serials, q.values) for q in quantities]
    p_values = holm(np.array([1.0 if trend is None else trend.p_value for trend in trends]))
    return tuple(
        _distribution(q, limit, trend, float(p))
        for q, trend, p in zip(quantities, trends, p_values, strict=True)
    )


def _quantities(fleet: Fleet) -> list[QuantityValues]:
    """Return names, values, errors and serial numbers of all quantities, in one pass."""
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
    all_names, serials = tuple(names), np.array(numbers)
    quantities = []
    for axis_name in sorted({axis for axis, _ in columns}):
        for quantity in QUANTITIES:
            indices, values, errors = columns[axis_name, quantity.name]
            if len(indices) < MIN_STAGES:
                continue
            is_complete = len(indices) == len(all_names)
            quantities.append(
                QuantityValues(
                    axis=axis_name,
                    quantity=quantity,
                    stages=all_names if is_complete else tuple(all_names[k] for k in indices),
                    values=np.array(values),
                    errors=np.array(errors),
                    serials=serials if is_complete else serials[np.array(indices)],
                )
            )
    return quantities


def _distribution(
    measured: QuantityValues, limit: float, trend: Trend | None, p_value: float
) -> Distribution:
    values, errors = measured.values, measured.errors
    drifts = trend is not None and p_value < TREND_P
    level = values - trend.slope * (measured.serials - trend.about) if trend and drifts else values
    ratio = measured.quantity.ratio and level.min() > 0.0
    scaled, errors = (np.log(level), errors / level) if ratio else (level, errors)
    scaled_spread = spread_beyond(scaled, errors)
    widened_limit = limit * (1.0 + WIDENING / len(values))
    typical_sigma = float(np.hypot(scaled_spread.sigma, np.median(errors)))
    limits = scaled_spread.median + widened_limit * typical_sigma * np.array([-1.0, 1.0])
    low, high = np.exp(limits) if ratio else limits
    return Distribution(
        **fields_of(measured),
        spread=spread_of(values),
        deviation=deviations(scaled, scaled_spread, errors),
        limit=widened_limit,
        normal=(float(low), float(high)),
        trend=trend,
        trend_p=p_value,
    )
