"""The residual against time, its running size beside the noise, and how it is distributed."""

import math

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import (
    Figure,
    Page,
    Part,
    Section,
    axis_heading,
    first_open,
    scale_of_errors,
)
from piezoid_reports.quantities import told
from piezoid_reports.traces import Trace, rms

SIGMAS = 2.0
LEAST_m = 1e-13  # below, no sensor reads; keeps a logarithm finite
WINDOWS = 60  # of a record, over which the rms is taken
CLASSES = 48
REACH = 4.5  # times the larger of residual and noise rms, of a histogram
HEIGHT = 240
LOOK_ENVELOPE = (
    "Good: the model's line lies a decade or more below the straight line's and runs along the "
    "noise. Bad: both are of the same size, so that the model earns nothing, or the model's line "
    "rises towards one end: something changed while it was recorded."
)
LOOK_HISTOGRAM = (
    "Good: the steps follow the bell of the noise. Bad: wider (the model lacks something), two "
    "humps (the branches differ: hysteresis left over), a long tail (spikes, slips)."
)
LOOK_AFTER = (
    "Good: structureless, mostly between the lines of the sensor's noise from beginning to end. "
    "Bad: waves with the period of the drive (hysteresis left over), slow bending (creep or "
    "drift), spikes at turning points (dynamics or lag), steps (slips, outliers)."
)


def render(page: Page) -> Section | None:
    """Return three figures for each recording."""
    parts: list[Part] = []
    for axis in page.axes:
        if not page.traces[axis.axis]:
            continue
        parts.append(axis_heading(axis))
        parts += first_open(
            [
                (after(trace, axis), _envelope(trace, axis), _histogram(trace, axis))
                for trace in page.drawn(axis)
            ]
        )
    if not parts:
        return None
    return Section(
        anchor="residual-over-time",
        title="Residual against time",
        lead="Measured minus modelled displacement. Each column of the drawing spans the least "
        "and the greatest residual in it, so no spike is lost.",
        parts=tuple(parts),
    )


def _envelope(trace: Trace, axis: AxisModel) -> Figure:
    """Draw the rms in windows of time: straight line, model, noise, in decades."""
    noise_m = axis.quality.noise_rms_m
    time_s, before_m = _running_rms(trace.time_s, trace.line_residual_m)
    _, after_m = _running_rms(trace.time_s, trace.residual_m)
    unit = scale_of_errors(axis)
    level = [np.log10(np.maximum(v, LEAST_m) / unit.factor) for v in (before_m, after_m)]
    noise = np.full(2, np.log10(max(noise_m, LEAST_m) / unit.factor))
    x = axis_over("time", [trace.time_s], "s")
    y = decades_over("rms of the residual", [*level, noise], unit.unit)
    canvas = Canvas(x=x, y=y, height=HEIGHT)
    window_s = float(trace.time_s[-1]) / WINDOWS
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: how large the residual is, in time",
        numbers=f"Over all, the straight line leaves {told(rms(trace.line_residual_m), 'm')} rms, "
        f"the model {told(rms(trace.residual_m), 'm')}, the sensor's noise is "
        f"{told(noise_m, 'm')}; windows of {told(window_s, 's')}.",
        look=LOOK_ENVELOPE,
        canvas=canvas,
        layers=(
            canvas.line("before", "straight line", time_s, level[0]),
            canvas.line("model", "model", time_s, level[1]),
            canvas.line("limit", "sensor noise", trace.time_s[[0, -1]], noise),
        ),
    )


def _running_rms(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return the middle of every window and the rms in it, NaN where nothing was counted."""
    pieces = np.array_split(np.arange(len(values)), min(WINDOWS, len(values)))
    middle = np.array([time_s[piece].mean() for piece in pieces])
    held = [values[piece][np.isfinite(values[piece])] for piece in pieces]
    return middle, np.array([rms(one) if len(one) else np.nan for one in held])


def _histogram(trace: Trace, axis: AxisModel) -> Figure:
    """Draw the residual's density beside that of the noise."""
    noise_m, residual_m = axis.quality.noise_rms_m, trace.residual_m
    there = residual_m[np.isfinite(residual_m)]
    widest_m = REACH * max(rms(there), noise_m, LEAST_m)
    edges = np.linspace(-widest_m, widest_m, CLASSES + 1)
    share = 100.0 * np.histogram(there, edges)[0] / len(there)
    # the percentage of normal noise that falls into every class
    sigma = max(noise_m, LEAST_m)
    below = np.array([math.erf(edge / (math.sqrt(2.0) * sigma)) for edge in edges])
    noise = np.asarray(50.0 * np.diff(below))
    x = axis_over("residual", [edges], "m")
    y = axis_over("share of the samples", [share, noise, np.zeros(1)], "%")
    canvas = Canvas(x=x, y=y, height=HEIGHT)
    corners = np.repeat(edges, 2)[1:-1]
    middle = (edges[1:] + edges[:-1]) / 2.0
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: the residual beside the noise",
        numbers=f"{told(rms(there), 'm')} rms against {told(noise_m, 'm')} of the sensor; half of "
        f"the samples within {told(float(np.median(np.abs(there))), 'm')}, 95 % within "
        f"{told(float(np.quantile(np.abs(there), 0.95)), 'm')}.",
        look=LOOK_HISTOGRAM,
        canvas=canvas,
        layers=(
            canvas.band("count", "residual", corners, np.zeros(len(corners)), np.repeat(share, 2)),
            canvas.line("model", "noise alone", middle, noise),
        ),
    )


def after(trace: Trace, axis: AxisModel, *, size: tuple[int, int] | None = None) -> Figure:
    """Draw what the model leaves, and the band of the noise; small for the first screen."""
    width, height = size or (Canvas.width, HEIGHT)
    noise_m, residual_m = axis.quality.noise_rms_m, trace.residual_m
    x = axis_over("time", [trace.time_s], "s")
    y = axis_over("residual", [residual_m, np.array([SIGMAS * noise_m])], "m", even=True)
    canvas = Canvas(x=x, y=y, width=width, height=height)
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: what the model leaves",
        numbers=(
            f"{told(rms(residual_m), 'm')} rms, at most "
            f"{told(float(np.nanmax(np.abs(residual_m))), 'm')}; twice the sensor's noise "
            f"of {told(noise_m, 'm')} rms holds {_inside(residual_m, noise_m)} of the "
            "samples, where noise alone would leave 95 %."
        ),
        look=LOOK_AFTER,
        canvas=canvas,
        is_small=size is not None,
        layers=(
            canvas.range_over_time("model", "residual", trace.time_s, residual_m),
            _limits(canvas, trace, noise_m),
        ),
    )


def _limits(canvas: Canvas, trace: Trace, noise_m: float) -> Layer:
    """Draw a line at plus and one at minus twice the noise, broken in between."""
    time_s = trace.time_s[[0, -1, -1, 0, -1]]
    level_m = SIGMAS * noise_m * np.array([1.0, 1.0, np.nan, -1.0, -1.0])
    return canvas.line("limit", "± 2 sensor noise", time_s, level_m)


def _inside(residual_m: Array, noise_m: float) -> str:
    there = residual_m[np.isfinite(residual_m)]
    return told(100.0 * float((np.abs(there) <= SIGMAS * noise_m).mean()), "%")
