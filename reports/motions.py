"""Following a raster and steps in time: reference, output, and in grey what has no control."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification.motion import Motion
from piezoid.verification.trace import rms_from
from piezoid.verification.verification import Verification
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import NANO, Figure
from piezoid_reports.quantities import told
from piezoid_reports.spirals import METHODS, LEAST_m
from piezoid_reports.traces import rms

TOGETHER = 5  # places: a single one crosses zero, which a logarithm shows as a fall to nothing
LOOK_TRACK = (
    "Good: what ships lies on the reference. Bad: it stays short (a gain), runs behind (a lag) or "
    "rings after a step. The grey line is the stage under a static gain, without inverse and "
    "feedback."
)
LOOK_ERROR = (
    "Good: after each turn or step the error falls to the noise at once, far below the grey. "
    "Bad: a tail that falls slowly (creep, or a loop too slow), or a floor as high as the grey."
)


def motions(found: Verification) -> tuple[Figure, ...]:
    """Draw every path that was kept in time: where the axis went, then how far it was off."""
    return tuple(
        figure
        for motion in found.motions
        for figure in (_track(motion, found), _error(motion, found))
    )


def _track(motion: Motion, found: Verification) -> Figure:
    time_s, wanted_m = _time_s(motion), np.array(motion.reference_m)
    runs = _runs(motion, found)
    x = axis_over("time", [time_s], "s")
    y = axis_over("displacement from the middle", [wanted_m, *(m for _, _, m in runs)], "m")
    canvas = Canvas(x=x, y=y)
    layers: list[Layer] = [
        canvas.line(role, METHODS[name], time_s, moved_m)[0] for role, name, moved_m in runs
    ]
    off = "; ".join(
        f"{METHODS[name]}: {told(rms(moved_m - wanted_m), 'm')}"
        for _, name, moved_m in reversed(runs)
    )
    return Figure(
        title=f"Axis {motion.axis}, {motion.scenario}: where it went",
        numbers=f"Away from the reference, rms: {off}.",
        look=LOOK_TRACK,
        x=x,
        y=y,
        layers=(*layers, canvas.line("zero", "reference", time_s, wanted_m)[0]),
    )


def _error(motion: Motion, found: Verification) -> Figure:
    wanted_m = np.array(motion.reference_m)
    starts = np.arange(0, len(wanted_m), TOGETHER, dtype=np.intp)
    time_s = _time_s(motion)[starts]
    errors = [
        (role, name, rms_from(starts, moved_m - wanted_m))
        for role, name, moved_m in _runs(motion, found)
    ]
    logs = [np.log10(np.maximum(error_m, LEAST_m) / NANO) for _, _, error_m in errors]
    x = axis_over("time", [time_s], "s")
    y = decades_over("distance from the reference", logs, "nm")
    canvas = Canvas(x=x, y=y)
    middle = "; ".join(
        f"{METHODS[name]}: {told(float(np.median(error_m)), 'm')}"
        for _, name, error_m in reversed(errors)
    )
    return Figure(
        title=f"Axis {motion.axis}, {motion.scenario}: how far it was off",
        numbers=f"Half of the time closer than this, rms over {TOGETHER} places: {middle}.",
        look=LOOK_ERROR,
        x=x,
        y=y,
        layers=tuple(
            canvas.line(role, METHODS[name], time_s, log)[0]
            for (role, name, _), log in zip(errors, logs, strict=True)
        ),
    )


def _time_s(motion: Motion) -> Array:
    return np.linspace(0.0, motion.duration_s, len(motion.reference_m), endpoint=False)


def _runs(motion: Motion, found: Verification) -> list[tuple[str, str, Array]]:
    """Return role, method and way, what ships last: it is drawn on top."""
    runs = [("model", found.methods[motion.axis], np.array(motion.shipped_m))]
    if motion.uncompensated_m:
        runs.insert(0, ("grey", "none", np.array(motion.uncompensated_m)))
    return runs
