"""The residual against time: before and after the model, then on its own scale."""

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.page import Figure, Page, Part, Section, axis_heading
from piezoid_reports.quantities import told
from piezoid_reports.traces import Trace, rms

SIGMAS = 2.0
LOOK_BEFORE = (
    "Good: with the model the residual shrinks to a thin line on the scale of what a straight "
    "line leaves. Bad: both are of the same size, so that the model earns nothing."
)
LOOK_AFTER = (
    "Good: structureless, mostly between the lines of the sensor's noise from beginning to end. "
    "Bad: waves with the period of the drive (hysteresis left over), slow bending (creep or "
    "drift), spikes at turning points (dynamics or lag), steps (slips, outliers)."
)


def render(page: Page) -> Section | None:
    """Return two figures for each recording."""
    parts: list[Part] = []
    for axis in page.axes:
        if not page.traces[axis.axis]:
            continue
        parts.append(axis_heading(axis))
        for trace in page.drawn(axis):
            parts += [_before_and_after(trace, axis), _after(trace, axis)]
    if not parts:
        return None
    return Section(
        anchor="residual-over-time",
        title="Residual against time",
        lead="Measured minus modelled displacement. Each column of the drawing spans the least "
        "and the greatest residual in it, so no spike is lost.",
        parts=tuple(parts),
    )


def _before_and_after(trace: Trace, axis: AxisModel) -> Figure:
    before_m, after_m = trace.line_residual_m, trace.residual_m
    x = axis_over("time", [trace.time_s], "s")
    y = axis_over("residual", [before_m, after_m], "m", even=True)
    canvas = Canvas(x=x, y=y, height=240)
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: straight line and model",
        numbers=(
            f"Before, with the best straight line: {told(rms(before_m), 'm')} rms. "
            f"After, with the model: {told(rms(after_m), 'm')} rms."
        ),
        look=LOOK_BEFORE,
        x=x,
        y=y,
        height=canvas.height,
        layers=(
            canvas.range_over_time("before", "before: straight line", trace.time_s, before_m),
            canvas.range_over_time("model", "after: model", trace.time_s, after_m),
        ),
        flicker=("before", "model"),
    )


def _after(trace: Trace, axis: AxisModel) -> Figure:
    noise_m, residual_m = axis.quality.noise_rms_m, trace.residual_m
    x = axis_over("time", [trace.time_s], "s")
    y = axis_over("residual", [residual_m, np.array([SIGMAS * noise_m])], "m", even=True)
    canvas = Canvas(x=x, y=y, height=240)
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: what the model leaves",
        numbers=(
            f"{told(rms(residual_m), 'm')} rms, at most "
            f"{told(float(np.nanmax(np.abs(residual_m))), 'm')}; twice the sensor's noise "
            f"of {told(noise_m, 'm')} rms holds {_inside(residual_m, noise_m)} of the "
            "samples, where noise alone would leave 95 %."
        ),
        look=LOOK_AFTER,
        x=x,
        y=y,
        height=canvas.height,
        layers=(
            canvas.range_over_time("model", "residual", trace.time_s, residual_m),
            _limits(canvas, trace, noise_m),
        ),
    )


def _limits(canvas: Canvas, trace: Trace, noise_m: float) -> Layer:
    """Draw a line at plus and one at minus twice the noise, broken in between."""
    time_s = trace.time_s[[0, -1, -1, 0, -1]]
    level_m = SIGMAS * noise_m * np.array([1.0, 1.0, np.nan, -1.0, -1.0])
    return canvas.line("limit", "± 2 sensor noise", time_s, level_m)[0]


def _inside(residual_m: Array, noise_m: float) -> str:
    there = residual_m[np.isfinite(residual_m)]
    return told(100.0 * float((np.abs(there) <= SIGMAS * noise_m).mean()), "%")
