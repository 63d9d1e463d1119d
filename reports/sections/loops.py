"""The loops, with the model over the measurement."""

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid_reports.chart import Canvas, axis_over
from piezoid_reports.page import Figure, Heading, Page, Part, Section, Table
from piezoid_reports.quantities import percent, told
from piezoid_reports.traces import Trace, rms

LOOK = (
    "Good: the thin model line lies inside the broad measured one on every branch, the small "
    "loops included. Bad: it leaves the measured line at the turning points, cuts the corners of "
    "small loops, or the loop crosses itself."
)


def render(page: Page) -> Section | None:
    """Return a figure for each recording, and a table of all."""
    parts: list[Part] = []
    for axis in page.axes:
        if not page.traces[axis.axis]:
            continue
        parts.append(Heading(text=f"Axis {axis.axis}"))
        parts += [_figure(page, axis, trace) for trace in page.drawn(axis)]
        parts.append(_table(page, axis))
    if not parts:
        return None
    return Section(
        anchor="loops",
        title="Loops: model over measurement",
        lead="Displacement against drive. The model runs free: it sees the drive and its own "
        "fitted start, never the measured displacement.",
        parts=tuple(parts),
    )


def _figure(page: Page, axis: AxisModel, trace: Trace) -> Figure:
    x = axis_over("drive", [trace.voltage_V], "V")
    y = axis_over("displacement", [trace.measured_m, trace.modelled_m], "m")
    canvas = Canvas(x=x, y=y)
    measured, far = canvas.line(
        "measured", "measured", trace.voltage_V, trace.measured_m, points=page.points
    )
    model, far_too = canvas.line(
        "model", "model", trace.voltage_V, trace.modelled_m, points=page.points
    )
    left_m = rms(trace.residual_m)
    return Figure(
        title=f"{trace.recording.name}, axis {axis.axis}",
        numbers=(
            f"Residual {told(left_m, 'm')} rms, "
            f"{percent(left_m / float(np.ptp(trace.measured_m)))} of this recording's "
            f"{told(float(np.ptp(trace.measured_m)), 'm')} range. Curves are drawn to within "
            f"{told(max(far, far_too), 'm', 2)}."
        ),
        look=LOOK,
        x=x,
        y=y,
        layers=(measured, model),
        flicker=("measured", "model"),
    )


def _table(page: Page, axis: AxisModel) -> Table:
    traces = page.traces[axis.axis]
    drawn = len(page.drawn(axis))
    rest = "" if drawn == len(traces) else f" The {drawn} with the largest residual are drawn."
    return Table(
        caption=f"Axis {axis.axis}: residual of each recording of the fit.{rest}",
        columns=("recording", "drive", "range", "line leaves (rms)", "model leaves (rms)"),
        rows=tuple(
            (
                trace.recording.name,
                f"{told(float(trace.voltage_V.min()), 'V')} to "
                f"{told(float(trace.voltage_V.max()), 'V')}",
                told(float(np.ptp(trace.measured_m)), "m"),
                told(rms(trace.line_residual_m), "m"),
                told(rms(trace.residual_m), "m"),
            )
            for trace in traces
        ),
    )
