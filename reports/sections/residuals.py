"""Residuals against time and drive, and samples left out of the fit."""

import numpy as np

from piezoid.formatting import count_of
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import runs_of
from piezoid_reports.chart import Canvas, axis_over, bins_of
from piezoid_reports.page import Page, Trace, rms
from piezoid_reports.parts import Figure, Part, Section, axis_heading, folded
from piezoid_reports.quantities import number, percent

SIGMAS = 2.0
TIME_HEIGHT = 240  # pixels
DRIVE_BINS, MIN_BIN_SAMPLES = 60, 8  # quantiles need a minimum of samples
MIN_TICK = 1 / 600  # of the recording: half a pixel
GUIDE_TIME = (
    "Good: structureless, mostly between the dashed lines. Bad: waves with the period of the "
    "drive (hysteresis), slow bending (creep or drift), spikes at turning points (dynamics)."
)
GUIDE_DRIVE = (
    "Good: both medians follow zero. Bad: they separate (loop width wrong) or bend together "
    "(static curve wrong)."
)


def render(page: Page) -> Section | None:
    """Return the residuals against time and drive for each axis."""
    parts: list[Part] = []
    for axis in page.axes:
        traces = page.plotted_traces(axis)
        if not traces:
            continue
        parts += [axis_heading(axis), over_time(traces[0], axis)]
        parts.append(_over_drive(axis, page.traces[axis.axis]))
        further = [over_time(trace, axis) for trace in traces[1:]]
        parts += folded(f"More residuals: {count_of(len(further), 'figure')}", further)
    if not parts:
        return None
    return Section(
        anchor="residuals",
        title="Residuals",
        lead="Measured minus modelled displacement. A vertical line spans neighbouring samples, "
        "from the smallest to the largest.",
        parts=tuple(parts),
    )


def over_time(
    trace: Trace, axis: AxisModel, *, width: int = Canvas.width, height: int = TIME_HEIGHT
) -> Figure:
    """Draw the residual against time with the band of the noise; sizes are in pixels."""
    noise_m, residual_m = axis.quality.noise_rms_m, trace.residual_m
    x = axis_over("time", [trace.time_s], "s")
    y = axis_over("residual", [residual_m, np.array([SIGMAS * noise_m])], "m", symmetric=True)
    canvas = Canvas(x=x, y=y, width=width, height=height)
    ends_s = trace.time_s[[0, -1, -1, 0, -1]]
    limits_m = SIGMAS * noise_m * np.array([1.0, 1.0, np.nan, -1.0, -1.0])
    finite_m = np.abs(residual_m[np.isfinite(residual_m)])
    inside = float((finite_m <= SIGMAS * noise_m).mean())
    layers = [
        canvas.range_over_time("model", "residual", trace.time_s, residual_m),
        canvas.line("limit", "± 2 sensor noise", ends_s, limits_m),
    ]
    omitted = runs_of(~np.isfinite(trace.modelled_m))
    if omitted:  # draw a bar under each run, at least half a pixel wide
        bars_s = trace.time_s[np.minimum(omitted, len(trace.time_s) - 1)]
        bars_s[:, 1] = np.maximum(bars_s[:, 1], bars_s[:, 0] + MIN_TICK * np.ptp(trace.time_s))
        x_s = np.column_stack([bars_s, np.full(len(bars_s), np.nan)]).ravel()
        y_m = np.where(np.isfinite(x_s), canvas.y.low * canvas.y.scale.factor, np.nan)
        layers.append(canvas.line("missing", "left out of the fit", x_s, y_m))
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: residual against time",
        caption=f"{number(rms(residual_m), 'm')} rms, at most "
        f"{number(float(finite_m.max()), 'm')}; {percent(inside)} of the samples lie within "
        f"twice the sensor noise of {number(noise_m, 'm')} (95 % expected for noise alone).",
        guide=GUIDE_TIME,
        canvas=canvas,
        layers=tuple(layers),
    )


def _over_drive(axis: AxisModel, traces: tuple[Trace, ...]) -> Figure:
    voltage_V = np.concatenate([trace.voltage_V for trace in traces])
    residual_m = np.concatenate([trace.residual_m for trace in traces])
    rises = []  # for each sample whether the latest change of the drive was upwards
    for trace in traces:
        step = np.sign(np.diff(trace.voltage_V, prepend=trace.voltage_V[0]))
        latest = np.maximum.accumulate(np.where(step != 0, np.arange(len(step)), 0))
        rises.append(step[latest] > 0)
    is_rising, is_finite = np.concatenate(rises), np.isfinite(residual_m)
    edges_V = np.linspace(voltage_V.min(), voltage_V.max(), DRIVE_BINS + 1)
    branches = []  # centre of the bin and 5 %, 50 % and 95 % quantiles, (bins, 4)
    for branch in (is_rising, ~is_rising):
        drive_V, error_m = voltage_V[is_finite & branch], residual_m[is_finite & branch]
        rows = [
            [(edges_V[k] + edges_V[k + 1]) / 2, *np.quantile(error_m[samples], [0.05, 0.5, 0.95])]
            for k, samples in bins_of(drive_V, edges_V, MIN_BIN_SAMPLES)
        ]
        branches.append(np.array(rows).reshape(-1, 4))
    rising, falling = branches
    x = axis_over("drive", [voltage_V], "V")
    curves = [rising[:, 1:].ravel(), falling[:, 1:].ravel()]
    canvas = Canvas(x=x, y=axis_over("residual", curves, "m", symmetric=True))
    largest = [
        number(float(np.abs(bins[:, 2]).max()) if len(bins) else np.nan, "m")
        for bins in (rising, falling)
    ]
    return Figure(
        title=f"Axis {axis.axis}: residual against drive",
        caption=f"Largest median {largest[0]} rising, {largest[1]} falling; bands hold 90 %.",
        guide=GUIDE_DRIVE,
        canvas=canvas,
        layers=(
            *canvas.quantiles("rising", "rising", "90 %", rising),
            *canvas.quantiles("falling", "falling", "90 %", falling),
        ),
    )
