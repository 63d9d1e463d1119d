"""A spiral as it was run, its colour how far its shape was wrong, in parts of what is allowed."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification.criteria import SHAPE, Limits
from piezoid.verification.trace import SpiralTrace
from piezoid.verification.verification import Verification
from piezoid_reports.chart import Canvas, Layer, axis_over
from piezoid_reports.page import Figure
from piezoid_reports.quantities import told

SQUARE = 440
METHODS = {
    "none": "static gain, no feedback",
    "mpi": "inverse of the hysteresis, no feedback",
    "dob": "disturbance observer with an affine map",
    "mpi_dob": "disturbance observer on the inverse",
    "rst": "R, S, T on the logarithm of the current",
}
SHADES = {"measured": 0.1, "good": 1.0 / 3.0, "middling": 1.0, "bad": np.inf}  # of the limit


def spiral(trace: SpiralTrace, found: Verification) -> Figure:
    """Draw one path, its colour the shape error there."""
    x_m, y_m, error_m = (np.array(v) for v in (trace.x_m, trace.y_m, trace.shape_error_m))
    reach_m = np.array([-1.0, 1.0]) * max(float(np.abs([x_m, y_m]).max()), found.radius_m)
    moving = f"axis {trace.axes[0]}"
    other = f"axis {trace.axes[1]}" if len(trace.axes) > 1 else "where a second axis would be"
    x, y = axis_over(moving, [reach_m], "m"), axis_over(other, [reach_m], "m")
    canvas = Canvas(x=x, y=y, width=SQUARE, height=SQUARE)
    limit_m = _shape_limit_m(found)
    return Figure(
        title=f"Spiral of {told(trace.frequency_Hz, 'Hz')}: {METHODS[trace.method]}",
        numbers=f"Colour is the shape error: largest {told(float(error_m.max()), 'm')}, median "
        f"{told(float(np.median(error_m)), 'm')}; allowed is {told(limit_m, 'm')} rms.",
        look="Good: the first colour everywhere. Bad: the last colours at the turning points of "
        "one axis, which is hysteresis left over, or more and more of them outwards, which is a "
        "gain.",
        x=x,
        y=y,
        layers=tuple(_shaded(canvas, x_m, y_m, error_m, limit_m)),
        width=SQUARE,
        height=SQUARE,
    )


def _shape_limit_m(found: Verification) -> float:
    """Return what the shape of a spiral may be wrong by: the verdict's limit."""
    percent = [v.limit for v in found.verdicts if v.name == SHAPE]
    return (percent[0] if percent else Limits().aligned_percent) / 100.0 * 2.0 * found.radius_m


def _shaded(canvas: Canvas, x_m: Array, y_m: Array, error_m: Array, limit_m: float) -> list[Layer]:
    """Draw a curve in shades, by the parts of the limit its error reaches."""
    edges_m = [limit_m * share if np.isfinite(share) else np.inf for share in SHADES.values()]
    shade = np.searchsorted(edges_m, error_m)
    layers = []
    for place, (role, share) in enumerate(SHADES.items()):
        held = shade == place
        if not held.any():
            continue
        held |= np.r_[False, held[:-1]]  # each stretch goes on to where the next one begins
        name = f"up to {told(share * limit_m, 'm')}" if np.isfinite(share) else "more"
        x, y = np.where(held, x_m, np.nan), np.where(held, y_m, np.nan)
        layers.append(canvas.line(f"error-{role}", name, x, y)[0])
    return layers
