"""What a fleet shows: spread of every quantity, stages that stand out, trends over serial numbers.

Every look at a stage is a chance to be wrong, so the thresholds know how often was looked.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import Spread, Trend, deviations, holm, spread_of, trend_of
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
    away     (count,)  in robust standard deviations; from the trend, where there is one; of the
             logarithm where ratios count
    limit    beyond which a stage stands out
    normal   the values between which none does, about the middle of all
    trend    over serial numbers, its p-value corrected for all that were looked at
    """

    axis: str
    quantity: Quantity
    stages: tuple[str, ...]
    serials: Array
    values: Array
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
    held = [
        found
        for axis in fleet.axes
        for quantity in QUANTITIES
        if len((found := _held(fleet, axis, quantity))[2]) >= FEWEST
    ]
    looks = sum(len(values) for *_, values, _ in held)
    limit = float(norm.isf(FALSE_ALARMS / max(looks, 1) / 2))
    trends = [trend_of(serials, values) for *_, values, serials in held]
    p_values = holm(np.array([1.0 if trend is None else trend.p_value for trend in trends]))
    return tuple(
        _distribution(one, limit, trend, float(p))
        for one, trend, p in zip(held, trends, p_values, strict=True)
    )


Scale = Callable[[Array], Array]
_Held = tuple[str, Quantity, tuple[str, ...], Array, Array]


def _held(fleet: Fleet, axis: str, quantity: Quantity) -> _Held:
    """Return axis, quantity, and name, value and serial of every stage that has it."""
    rows = [
        (stage.name, found.values[quantity.name], stage.serial)
        for stage in fleet.stages
        for found in stage.axes
        if found.axis == axis and found.applies and quantity.name in found.values
    ]
    serials = np.array([np.nan if serial is None else float(serial) for *_, serial in rows])
    values = np.array([value for _, value, _ in rows], dtype=float)
    return axis, quantity, tuple(name for name, *_ in rows), values, serials


def _distribution(held: _Held, limit: float, trend: Trend | None, p_value: float) -> Distribution:
    axis, quantity, stages, values, serials = held
    drifts = trend is not None and p_value < TREND_P
    level = values - trend.slope * (serials - trend.about) if trend and drifts else values
    scale: Scale = np.log if quantity.ratio and level.min() > 0.0 else np.asarray
    compared = spread_of(scale(level))
    reach = limit * (1.0 + WIDENED / len(values))
    ends = compared.median + reach * compared.sigma * np.array([-1.0, 1.0])
    low, high = np.exp(ends) if scale is np.log else ends
    return Distribution(
        axis=axis,
        quantity=quantity,
        stages=stages,
        serials=serials,
        values=values,
        spread=spread_of(values),
        away=deviations(scale(level), compared),
        limit=reach,
        normal=(float(low), float(high)),
        trend=trend,
        trend_p=p_value,
    )
