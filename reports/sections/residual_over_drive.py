"""The residual against the drive, rising and falling branches apart."""

import itertools

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.page import Figure, Page, Part, Section, axis_heading
from piezoid_reports.quantities import told
from piezoid_reports.traces import Trace

BINS = 60
LEAST_SAMPLES = 8  # in a bin: fewer have no quantiles
LOOK = (
    "Good: both medians run along zero, and the bands are as wide as the sensor's noise. Bad: the "
    "medians of rising and falling branches part (loop width wrong), bend together (the static "
    "curve wrong), or the bands widen at the ends of the range."
)


def render(page: Page) -> Section | None:
    """Return one figure for each axis, all its recordings together."""
    parts: list[Part] = []
    for axis in page.axes:
        if page.traces[axis.axis]:
            parts += [axis_heading(axis), _figure(axis, page.traces[axis.axis])]
    if not parts:
        return None
    return Section(
        anchor="residual-over-drive",
        title="Residual against drive",
        lead="All recordings of an axis together, in classes of drive. Bands hold the middle 90 % "
        "of the residual; lines are medians.",
        parts=tuple(parts),
    )


def _figure(axis: AxisModel, traces: tuple[Trace, ...]) -> Figure:
    voltage_V = np.concatenate([t.voltage_V for t in traces])
    residual_m = np.concatenate([t.residual_m for t in traces])
    rising = np.concatenate([_rises(t) for t in traces])
    there = np.isfinite(residual_m)
    up, down = (
        _classes(voltage_V[there & way], residual_m[there & way], voltage_V)
        for way in (rising, ~rising)
    )
    x = axis_over("drive", [voltage_V], "V")
    y = axis_over("residual", [up[:, 1:].ravel(), down[:, 1:].ravel()], "m", even=True)
    canvas = Canvas(x=x, y=y)
    return Figure(
        title=f"Axis {axis.axis}: residual against drive",
        numbers=(
            f"Largest median: {told(_largest(up), 'm')} rising, {told(_largest(down), 'm')} "
            f"falling; sensor noise {told(axis.quality.noise_rms_m, 'm')} rms."
        ),
        look=LOOK,
        canvas=canvas,
        layers=(*_layers(canvas, "rising", up), *_layers(canvas, "falling", down)),
    )


def _rises(trace: Trace) -> NDArray[np.bool_]:
    """Tell for each sample whether the drive last moved upwards."""
    step = np.sign(np.diff(trace.voltage_V, prepend=trace.voltage_V[0]))
    last = np.maximum.accumulate(np.where(step != 0, np.arange(len(step)), 0))
    return np.asarray(step[last] > 0)


def _classes(voltage_V: Array, residual_m: Array, all_V: Array) -> Array:
    """Return middle of the class, 5 %, 50 % and 95 % quantiles, (classes, 4)."""
    edges = np.linspace(all_V.min(), all_V.max(), BINS + 1)
    place = np.clip(np.searchsorted(edges, voltage_V, side="right") - 1, 0, BINS - 1)
    order = np.argsort(place, kind="stable")
    cuts = np.searchsorted(place[order], np.arange(BINS + 1))
    rows = [
        [(edges[k] + edges[k + 1]) / 2, *np.quantile(residual_m[order[a:b]], [0.05, 0.5, 0.95])]
        for k, (a, b) in enumerate(itertools.pairwise(cuts))
        if b - a >= LEAST_SAMPLES
    ]
    return np.array(rows).reshape(-1, 4)


def _layers(canvas: Canvas, role: str, classes: Array) -> tuple[Layer, ...]:
    if len(classes) < 2:
        return ()
    middle, low, median, high = classes.T
    line = canvas.line(role, f"{role}: median", middle, median)
    return canvas.band(f"{role}-band", f"{role}: middle 90 %", middle, low, high), line


def _largest(classes: Array) -> float:
    return float(np.abs(classes[:, 2]).max()) if len(classes) else float("nan")
