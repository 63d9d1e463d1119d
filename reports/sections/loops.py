"""Hysteresis loops: model and measurement."""

import numpy as np

from piezoid.formatting import count_of
from piezoid.identification.model import AxisModel
from piezoid_reports.chart import Canvas, axis_over
from piezoid_reports.page import Page, Trace, rms
from piezoid_reports.parts import Figure, Part, Section, Table, axis_heading, folded
from piezoid_reports.quantities import number

SMALL_POINTS = 900  # of a curve in the summary
GUIDE = (
    "Good: the thin line of the model lies on the broad line of the measurement on every branch. "
    "Bad: the model departs from the measurement after a turning point or in small loops."
)


def render(page: Page) -> Section | None:
    """Return figures and a table of the residuals for each axis."""
    parts: list[Part] = []
    for axis in page.axes:
        traces = page.plotted_traces(axis)
        if not traces:
            continue
        further = [without_line(page, axis, trace) for trace in traces[1:]]
        parts += [axis_heading(axis), without_line(page, axis, traces[0])]
        parts += folded(f"More loops: {count_of(len(further), 'figure')}", further)
        parts.append(
            Table(
                caption=f"Axis {axis.axis}: residual of each recording, rms.",
                columns=("recording", "drive", "range", "left out", "straight line", "model"),
                rows=tuple(
                    (
                        trace.recording.name,
                        f"{number(float(trace.voltage_V.min()), 'V')} to "
                        f"{number(float(trace.voltage_V.max()), 'V')}",
                        number(trace.range_m, "m"),
                        f"{(~np.isfinite(trace.modelled_m)).sum()} of {len(trace.time_s)}",
                        number(rms(trace.line_residual_m), "m"),
                        number(rms(trace.residual_m), "m"),
                    )
                    for trace in page.traces[axis.axis]
                ),
            )
        )
    if not parts:
        return None
    return Section(
        anchor="loops",
        title="Loops",
        lead="Simulated from the drive and the fitted initial state, without the measured "
        "displacement.",
        parts=tuple(parts),
    )


def without_line(
    page: Page, axis: AxisModel, trace: Trace, *, size: tuple[int, int] | None = None
) -> Figure:
    """Draw a loop minus its straight line, which magnifies its width.

    size  width and height in pixels in the summary, None elsewhere
    """
    curves = {
        "measured": trace.line_residual_m,
        "model": np.asarray(trace.modelled_m - trace.line_m),
    }
    width, height = size or (Canvas.width, Canvas.height)
    x = axis_over("drive", [trace.voltage_V], "V")
    y = axis_over("displacement minus straight line", list(curves.values()), "m")
    canvas, is_small = Canvas(x=x, y=y, width=width, height=height), size is not None
    points = min(page.points, SMALL_POINTS) if is_small else page.points
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}: loop without straight line",
        caption=f"Residual {number(rms(trace.line_residual_m), 'm')} rms with a straight line, "
        f"{number(rms(trace.residual_m), 'm')} with the model.",
        guide=GUIDE,
        canvas=canvas,
        layers=tuple(
            canvas.line(n, n, trace.voltage_V, m, points=points, timed=is_small)
            for n, m in curves.items()
        ),
        is_small=is_small,
    )
