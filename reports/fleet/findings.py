"""Statistics of a batch: spread of every quantity, outliers, trends over serial numbers.

Every look at a stage is a chance to be wrong, so the thresholds know how often was looked.
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

FEWEST = 5  # stages from which a spread is one
# A spread of few stages is itself uncertain: the limit is widened by 12 over their number, which
# keeps the false alarms of normal samples of 5 to 200 stages below what is said (tested).
WIDENED = 12.0
FALSE_ALARMS = 0.5  # stages expected to stand out by chance in a batch where nothing is wrong
TREND_P = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class QuantityValues:
    """One quantity of one axis over all stages that have it.

    stages   (count,)  names
    serials  (count,)  NaN where a name holds no number
    values   (count,)  SI
    errors   (count,)  their standard errors; 0 where none is known
    """

    axis: str
    quantity: Quantity
    stages: tuple[str, ...]
    serials: Array
    values: Array
    errors: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution(QuantityValues):
    """The spread of a quantity, the stages that stand out, and its trend.

    spread   of the values, as they are
    away     (count,)  in robust standard deviations of the stages and of the value itself, which
             may hardly be known; from the trend, where there is one; of the logarithm where
             ratios count
    limit    beyond which a stage stands out
    normal   the values between which none does that is known as well as most, about the middle
    trend    over serial numbers, its p-value corrected for all that were looked at
    """

    spread: Spread
    away: Array
    limit: float
    normal: tuple[float, float]
    trend: Trend | None
    trend_p: float

    @property
    def drifts(self) -> bool:
        """Whether the trend is more than chance."""
        return self.trend is not None and self.trend_p < TREND_P

    @property
    def outliers(self) -> tuple[int, ...]:
        """Places of the stages that stand out, farthest first."""
        outliers = np.flatnonzero(np.abs(self.away) > self.limit)
        return tuple(
            int(k) for k in outliers[np.argsort(-np.abs(self.away[outliers]), kind="stable")]
        )


def compare_stages(fleet: Fleet) -> tuple[Distribution, ...]:
    """Return every quantity that at least ``FEWEST`` stages have, axis by axis."""
    quantities = _quantities(fleet)
    looks = sum(len(q.values) for q in quantities)
    limit = float(-normal_quantile(FALSE_ALARMS / max(looks, 1) / 2))
    trends = [trend_of(q.serials, q.values) for q in quantities]
    p_values = holm(np.array([1.0 if trend is None else trend.p_value for trend in trends]))
    return tuple(
        _distribution(q, limit, trend, float(p))
        for q, trend, p in zip(quantities, trends, p_values, strict=True)
    )


def _quantities(fleet: Fleet) -> list[QuantityValues]:
    """Return names, values, errors and serials of all that is compared, in one pass."""
    names: list[str] = []
    numbers = array("d")
    # Of each quantity of an axis: stage, value and error, 20 bytes a stage.
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
            if len(indices) < FEWEST:
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
    compared = spread_beyond(scaled, errors)
    reach = limit * (1.0 + WIDENED / len(values))
    usual = float(np.hypot(compared.sigma, np.median(errors)))
    limits = compared.median + reach * usual * np.array([-1.0, 1.0])
    low, high = np.exp(limits) if ratio else limits
    return Distribution(
        **fields_of(measured),
        spread=spread_of(values),
        away=deviations(scaled, compared, errors),
        limit=reach,
        normal=(float(low), float(high)),
        trend=trend,
        trend_p=p_value,
    )
