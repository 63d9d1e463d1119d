"""Drive and displacement against time: what was done to the stage, and what it did."""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.first_screen import left_out
from piezoid_reports.page import Figure, Page, Part, Prose, Section, axis_heading, first_open
from piezoid_reports.quantities import percent, told
from piezoid_reports.traces import Trace

TICK = 1 / 600  # of the recording: half a pixel
HEIGHT = 200
MUCH = 0.05  # of all samples, left out: worth a warning; a run-in seldom takes more
LOOK_DRIVE = (
    "Good: several cycles over the whole range, of different sizes and speeds. Bad: one branch, "
    "one size or one speed: what was not done here nobody can know."
)
LOOK_DISPLACEMENT = (
    "Good: it follows the drive, cycle after cycle alike, without red marks. Bad: steps, spikes, "
    "a slow slope, gaps, or red marks: samples that the fit had to leave out."
)


def render(page: Page) -> Section | None:
    """Return two figures for each recording, and how many samples were left out."""
    parts: list[Part] = []
    for axis in page.axes:
        if not page.traces[axis.axis]:
            continue
        parts += [axis_heading(axis), *_counted(page, axis)]
        parts += first_open([(_drive(t, axis), _moved(t, axis)) for t in page.drawn(axis)])
    if not parts:
        return None
    return Section(
        anchor="motion",
        title="Drive and displacement",
        lead="What was recorded, as it is in the files. Samples that no fit used are marked.",
        parts=tuple(parts),
    )


def _counted(page: Page, axis: AxisModel) -> tuple[Part, ...]:
    missing, total = left_out(page.traces[axis.axis])
    if not missing:
        return ()
    text = (
        f"The fit left out {missing} of {total} samples ({percent(missing / total)}): gaps, "
        "faults of the data, and what belongs to no cycle."
    )
    return (Prose(text=text, tone="middling" if missing / total > MUCH else "plain"),)


def _drive(trace: Trace, axis: AxisModel) -> Figure:
    low_V, high_V = float(trace.voltage_V.min()), float(trace.voltage_V.max())
    return _over_time(
        trace,
        "drive",
        trace.voltage_V,
        "V",
        f"{trace.recording.name}, axis {axis.axis}: drive",
        f"{told(low_V, 'V')} to {told(high_V, 'V')} in {told(float(trace.time_s[-1]), 's')}, at "
        f"{told(trace.recording.sampling_rate_Hz, 'Hz')}.",
        LOOK_DRIVE,
    )


def _moved(trace: Trace, axis: AxisModel) -> Figure:
    missing = len(trace.time_s) - trace.counted
    return _over_time(
        trace,
        "displacement",
        trace.measured_m,
        "m",
        f"{trace.recording.name}, axis {axis.axis}: displacement",
        f"Range {told(trace.range_m, 'm')}; {missing} of {len(trace.time_s)} samples left out.",
        LOOK_DISPLACEMENT,
    )


def _over_time(
    trace: Trace, label: str, values: Array, unit: str, title: str, numbers: str, look: str
) -> Figure:
    x, y = axis_over("time", [trace.time_s], "s"), axis_over(label, [values], unit)
    canvas = Canvas(x=x, y=y, height=HEIGHT)
    kept = np.isfinite(trace.modelled_m)
    layers: list[Layer] = [
        canvas.range_over_time("before", label, trace.time_s, np.where(kept, values, np.nan))
    ]
    if not kept.all():
        layers.append(_marks(canvas, trace.time_s, kept))
    return Figure(
        title=title,
        numbers=numbers,
        look=look,
        canvas=canvas,
        layers=tuple(layers),
    )


def _marks(canvas: Canvas, time_s: Array, kept: NDArray[np.bool_]) -> Layer:
    """Draw a bar on the ground under every stretch of samples that was left out.

    A lost sample is a tick: wider, and one in twenty looks as if all were lost.
    """
    out = np.concatenate([[False], ~kept, [False]]).astype(int)
    edges = np.flatnonzero(np.diff(out))
    ends = time_s[np.minimum(edges, len(time_s) - 1)].reshape(-1, 2)
    ends[:, 1] = np.maximum(ends[:, 1], ends[:, 0] + TICK * np.ptp(time_s))
    low = canvas.y.low * canvas.y.scale.factor
    x = np.column_stack([ends, np.full(len(ends), np.nan)]).ravel()
    y = np.where(np.isfinite(x), low, np.nan)
    return canvas.line("missing", "left out of the fit", x, y)
