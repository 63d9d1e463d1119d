"""The chapter of a batch on its parameters: how each is spread, and whether it drifts."""

import numpy as np

from piezoid.readable import Scale
from piezoid_reports.chart import Axis, Canvas, Layer, axis_over
from piezoid_reports.fleet.findings import TREND_P, Distribution
from piezoid_reports.page import Figure, Heading, Part, Section, Table
from piezoid_reports.quantities import significant, told

NEGLIGIBLE = 1e-3  # of its interval: a slope below it is rounding
DOTS = 1000  # stages with a serial number that are drawn one by one
STRETCHES = 60  # of serial numbers, of each of which 5 % to 95 % are drawn
LOOK_SPREAD = (
    "Good: one hump, no stage outside the dashed lines. Bad: two humps (two batches of ceramics, "
    "two operators), a long tail, single stages far away."
)
LOOK_DRIFT = (
    "Good: dots scatter about a level line. Bad: a slope (tool wear, a changing supplier, a "
    "reference that ages), a step (a new batch, a new sensor), single dots far away."
)


def spread(found: tuple[Distribution, ...]) -> Section | None:
    """Return a table and, for each quantity, its histogram and its course over serial numbers."""
    if not found:
        return None
    parts: list[Part] = []
    for axis in dict.fromkeys(one.axis for one in found):
        own = [one for one in found if one.axis == axis]
        parts += [Heading(text=f"Axis {axis}"), _table(axis, own)]
        for one in own:
            if np.ptp(one.values) > 0.0:
                parts.append(_histogram(one))
            if one.trend is not None:
                parts.append(_course(one))
    return Section(
        anchor="parameters",
        title="Distribution and drift of the parameters",
        lead="Every stage to which the model applies, whether it passed or not.",
        parts=tuple(parts),
    )


def _table(axis: str, own: list[Distribution]) -> Table:
    return Table(
        caption=f"Axis {axis}: spread over the stages, and the drift for 100 serial numbers. A "
        f"drift counts if chance makes it in less than {100 * TREND_P:g} % of batches, all "
        "quantities taken together.",
        columns=("quantity", "stages", "median", "5 % to 95 %", "drift (95 %)", "p"),
        rows=tuple(
            (
                one.quantity.label,
                str(one.spread.count),
                told(one.spread.median, one.quantity.unit),
                f"{told(one.spread.low, one.quantity.unit)} to "
                f"{told(one.spread.high, one.quantity.unit)}",
                _drift(one),
                "" if one.trend is None else significant(one.trend_p, 2),
            )
            for one in own
        ),
    )


def _drift(one: Distribution) -> str:
    if one.trend is None:
        return "not known"
    low, high = (100.0 * end for end in one.trend.ci95)
    unit, slope = one.quantity.unit, 100.0 * one.trend.slope
    middle = slope if abs(slope) > NEGLIGIBLE * (high - low) else 0.0
    return f"{told(middle, unit)} ({told(low, unit)} to {told(high, unit)})"


def _histogram(one: Distribution) -> Figure:
    edges = np.histogram_bin_edges(
        one.values, bins=int(np.clip(2 * len(one.values) ** 0.5, 8, 40))
    )
    counts, _ = np.histogram(one.values, edges)
    across = np.repeat(edges, 2)
    up = np.concatenate([[0.0], np.repeat(counts, 2), [0.0]]).astype(float)
    limits = np.array(one.normal)
    inside = limits[(limits >= edges[0]) & (limits <= edges[-1])]
    y = Axis(label="stages", scale=Scale(factor=1.0, unit=""), low=0.0, high=1.08 * counts.max())
    canvas = Canvas(
        x=axis_over(one.quantity.label, [one.values], one.quantity.unit), y=y, height=200
    )
    layers = [canvas.band("count", "stages", across, np.zeros_like(up), up)]
    for level in inside:
        line = canvas.line(
            "limit", "limit for most stages", np.array([level, level]), np.array([0.0, y.high])
        )
        layers.append(line[0])
    return Figure(
        title=f"{one.quantity.label}, axis {one.axis}: how it is spread",
        numbers=f"{one.spread.count} stages, median {told(one.spread.median, one.quantity.unit)}, "
        f"robust standard deviation {told(one.spread.sigma, one.quantity.unit)}; "
        f"{_beyond(one)}.",
        look=LOOK_SPREAD,
        x=canvas.x,
        y=canvas.y,
        height=canvas.height,
        layers=tuple(layers),
    )


def _beyond(one: Distribution) -> str:
    many = f"{len(one.outliers)} beyond {one.limit:.1f} of them"
    own = ", each value's own interval counted in" if one.errors.any() else ""
    return f"{many}{', counted in the logarithm' if one.quantity.ratio else ''}{own}"


def _course(one: Distribution) -> Figure:
    assert one.trend is not None
    ends = np.array([np.nanmin(one.serials), np.nanmax(one.serials)])
    line = one.trend.middle + one.trend.slope * (ends - one.trend.about)
    x = axis_over("serial number", [one.serials], "")
    canvas = Canvas(
        x=x, y=axis_over(one.quantity.label, [one.values], one.quantity.unit), height=200
    )
    odd = np.zeros(len(one.values), dtype=bool)
    odd[list(one.outliers[:DOTS])] = True
    layers = [
        _many(canvas, one)
        if np.isfinite(one.serials).sum() > DOTS
        else canvas.dots("dots", "stages", one.serials[~odd], one.values[~odd]),
        canvas.line("trend", "median trend", ends, line)[0],
    ]
    if (odd & np.isfinite(one.serials)).any():
        layers.append(canvas.dots("odd", "standing out", one.serials[odd], one.values[odd]))
    return Figure(
        title=f"{one.quantity.label}, axis {one.axis}: over the serial numbers",
        numbers=f"Drift for 100 serial numbers {_drift(one)}, p = {significant(one.trend_p, 2)}: "
        f"{'a drift' if one.drifts else 'no drift that can be told from chance'}.",
        look=LOOK_DRIFT,
        x=canvas.x,
        y=canvas.y,
        height=canvas.height,
        layers=tuple(layers),
    )


def _many(canvas: Canvas, one: Distribution) -> Layer:
    """Draw between what values most stages lie, for each stretch of serial numbers."""
    numbered = np.flatnonzero(np.isfinite(one.serials))
    order = numbered[np.argsort(one.serials[numbered], kind="stable")]
    parts = np.array_split(order, STRETCHES)
    middle = np.array([np.median(one.serials[part]) for part in parts])
    low, high = np.array([np.quantile(one.values[part], (0.05, 0.95)) for part in parts]).T
    return canvas.band("count", "9 of 10 stages", middle, low, high)
