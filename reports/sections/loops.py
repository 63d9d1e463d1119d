"""The loops, with the model over the measurement."""

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, axis_over
from piezoid_reports.page import Figure, Page, Part, Section, Table, axis_heading, first_open
from piezoid_reports.quantities import percent, told
from piezoid_reports.traces import Trace, rms

SMALL_POINTS = 900  # of a curve on the first screen, a third as wide as others
LOOK_LOOP = (
    "Good: the thin model line lies inside the broad measured one on every branch, the small "
    "loops included. Bad: the loop crosses itself, or the model leaves it where it is widest."
)
LOOK_OPENED = (
    "The same with the best straight line taken away, which magnifies the loop. Good: thin on "
    "broad, branch by branch. Bad: the model leaves the measurement after a turning point, cuts "
    "the corners of small loops, or runs beside them."
)


def render(page: Page) -> Section | None:
    """Return a figure for each recording, and a table of all."""
    parts: list[Part] = []
    for axis in page.axes:
        if not page.traces[axis.axis]:
            continue
        parts.append(axis_heading(axis))
        drawn = [(opened(page, axis, t), _loop(page, axis, t)) for t in page.drawn(axis)]
        parts += first_open(drawn, shown=1)
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


def _loop(page: Page, axis: AxisModel, trace: Trace) -> Figure:
    left_m, range_m = rms(trace.residual_m), trace.range_m
    return _figure(
        page,
        trace,
        "displacement",
        (trace.measured_m, trace.modelled_m),
        f"{trace.recording.name}, axis {axis.axis}",
        f"Residual {told(left_m, 'm')} rms, {percent(left_m / range_m)} of this recording's "
        f"{told(range_m, 'm')} range.{_left_out(trace)}",
        LOOK_LOOP,
    )


def _left_out(trace: Trace) -> str:
    missing = len(trace.time_s) - trace.counted
    if not missing:
        return ""
    return (
        f" The fit left out {missing} of {len(trace.time_s)} samples; they have no model line and "
        "count in no residual."
    )


def opened(
    page: Page, axis: AxisModel, trace: Trace, *, canvas_size: tuple[int, int] | None = None
) -> Figure:
    """Draw the loop without its straight line; small for the first screen."""
    return _figure(
        page,
        trace,
        "displacement minus straight line",
        (trace.line_residual_m, trace.modelled_m - trace.line_m),
        f"{trace.recording.name}, axis {axis.axis}: the loop without its straight line",
        f"The straight line leaves {told(rms(trace.line_residual_m), 'm')} rms, the model "
        f"{told(rms(trace.residual_m), 'm')} rms.",
        LOOK_OPENED,
        size=canvas_size,
    )


def _figure(
    page: Page,
    trace: Trace,
    label: str,
    curves: tuple[Array, Array],
    title: str,
    numbers: str,
    look: str,
    size: tuple[int, int] | None = None,
) -> Figure:
    width, height = size or (Canvas.width, Canvas.height)
    canvas = Canvas(
        x=axis_over("drive", [trace.voltage_V], "V"),
        y=axis_over(label, curves, "m"),
        width=width,
        height=height,
    )
    is_small = size is not None
    points = min(page.points, SMALL_POINTS) if is_small else page.points
    (measured, far), (model, far_too) = (
        canvas.line_within(name, name, trace.voltage_V, values, points=points, timed=is_small)
        for name, values in zip(("measured", "model"), curves, strict=True)
    )
    return Figure(
        title=title,
        numbers=f"{numbers} Curves are drawn to within {told(max(far, far_too), 'm', 2)}.",
        look=look,
        canvas=canvas,
        layers=(measured, model),
        flicker=() if is_small else ("measured", "model"),
        is_small=is_small,
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
                told(trace.range_m, "m"),
                told(rms(trace.line_residual_m), "m"),
                told(rms(trace.residual_m), "m"),
            )
            for trace in traces
        ),
    )
