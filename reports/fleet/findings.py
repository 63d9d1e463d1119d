"""What a fleet shows: spread of every quantity, stages that stand out, trends over serial numbers.

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
from piezoid_reports.fleet.quantities import QUANTITIES, Quantity
from piezoid_reports.fleet.records import Fleet

FEWEST = 5  # stages from which a spread is one
# A spread of few stages is itself uncertain: the limit is widened by 12 over their number, which
# keeps the false alarms of normal samples of 5 to 200 stages below what is said (tested).
WIDENED = 12.0
FALSE_ALARMS = 0.5  # stages expected to stand out by chance in a batch where nothing is wrong
TREND_P = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution:
    """One quantity of one axis over all stages that have it.

    stages   (count,)  names
    serials  (count,)  NaN where a name holds no number
    values   (count,)  SI
    errors   (count,)  their standard errors; 0 where none is known
    spread   of the values, as they are
    away     (count,)  in robust standard deviations of the stages and of the value itself, which
             may hardly be known; from the trend, where there is one; of the logarithm where
             ratios count
    limit    beyond which a stage stands out
    normal   the values between which none does that is known as well as most, about the middle
    trend    over serial numbers, its p-value corrected for all that were looked at
    """

    axis: str
    quantity: Quantity
    stages: tuple[str, ...]
    serials: Array
    values: Array
    errors: Array
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
        far = np.flatnonzero(np.abs(self.away) > self.limit)
        return tuple(int(k) for k in far[np.argsort(-np.abs(self.away[far]), kind="stable")])


def distributions(fleet: Fleet) -> tuple[Distribution, ...]:
    """Return every quantity that at least ``FEWEST`` stages have, axis by axis."""
    held = _held(fleet)
    looks = sum(len(one.values) for one in held)
    limit = float(-normal_quantile(FALSE_ALARMS / max(looks, 1) / 2))
    trends = [trend_of(one.serials, one.values) for one in held]
    p_values = holm(np.array([1.0 if trend is None else trend.p_value for trend in trends]))
    return tuple(
        _distribution(one, limit, trend, float(p))
        for one, trend, p in zip(held, trends, p_values, strict=True)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Held:
    axis: str
    quantity: Quantity
    stages: tuple[str, ...]
    values: Array
    errors: Array
    serials: Array


class _Column:
    """One quantity of one axis, while the stages pass: 20 bytes a stage."""

    def __init__(self) -> None:
        self.place, self.value, self.error = array("l"), array("d"), array("d")

    def add(self, place: int, value: float, error: float) -> None:
        self.place.append(place)
        self.value.append(value)
        self.error.append(error)


def _held(fleet: Fleet) -> list[_Held]:
    """Return names, values, errors and serials of all that is compared, in one pass."""
    names: list[str] = []
    numbers = array("d")
    columns: defaultdict[tuple[str, str], _Column] = defaultdict(_Column)
    for place, stage in enumerate(fleet.stages):
        serial = stage.serial
        names.append(stage.name)
        numbers.append(np.nan if serial is None else float(serial))
        for axis in stage.axes:
            if axis.applies:
                for name, value in axis.values.items():
                    columns[axis.axis, name].add(place, value, axis.errors.get(name, 0.0))
    every, serials = tuple(names), np.array(numbers)
    found = []
    for axis_name in sorted({axis for axis, _ in columns}):
        for quantity in QUANTITIES:
            column = columns.pop((axis_name, quantity.name), None)
            if column is None or len(column.place) < FEWEST:
                continue
            whole = column.place == array("l", range(len(every)))
            found.append(
                _Held(
                    axis=axis_name,
                    quantity=quantity,
                    stages=every if whole else tuple(every[k] for k in column.place),
                    values=np.array(column.value),
                    errors=np.array(column.error),
                    serials=serials if whole else serials[np.array(column.place)],
                )
            )
    return found


def _distribution(held: _Held, limit: float, trend: Trend | None, p_value: float) -> Distribution:
    values, errors = held.values, held.errors
    drifts = trend is not None and p_value < TREND_P
    level = values - trend.slope * (held.serials - trend.about) if trend and drifts else values
    ratio = held.quantity.ratio and level.min() > 0.0
    scaled, own = (np.log(level), errors / level) if ratio else (level, errors)
    compared = spread_beyond(scaled, own)
    reach = limit * (1.0 + WIDENED / len(values))
    usual = float(np.hypot(compared.sigma, np.median(own)))
    ends = compared.median + reach * usual * np.array([-1.0, 1.0])
    low, high = np.exp(ends) if ratio else ends
    return Distribution(
        axis=held.axis,
        quantity=held.quantity,
        stages=held.stages,
        serials=held.serials,
        values=values,
        errors=errors,
        spread=spread_of(values),
        away=deviations(scaled, compared, own),
        limit=reach,
        normal=(float(low), float(high)),
        trend=trend,
        trend_p=p_value,
    )
