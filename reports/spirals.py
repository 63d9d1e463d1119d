"""Simulated spirals, coloured by their shape error in units of its limit, and tracking errors."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.runtime.schema import METHOD_NAMES
from piezoid.verification.criteria import SHAPE_ERROR, SHAPE_RATIO, Limits
from piezoid.verification.plotted_paths import UNCOMPENSATED, Motion, SpiralTrace, rms_from
from piezoid.verification.verification import Verification
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.parts import Figure
from piezoid_reports.quantities import number, significant

AVERAGED = 5  # places: a single one crosses zero, which a logarithm shows as a fall to nothing
GUIDE_ERROR = "Good: the error falls to the noise after each turn or step. Bad: a slow tail."

SQUARE = 440
NANO = 1e-9
STEPS = "steps"  # scenario whose error is drawn against time
SMALLEST_m = 1e-12  # below, an error is drawn as this: no stage is a picometre from its path
SHADES = {"measured": 0.1, "good": 1.0 / 3.0, "middling": 1.0, "bad": np.inf}  # of the limit


def spiral(trace: SpiralTrace, verification: Verification) -> Figure:
    """Draw one path, its colour the shape error there."""
    x_m, y_m, error_m = (np.array(v) for v in (trace.x_m, trace.y_m, trace.shape_error_m))
    reach_m = np.array([-1.0, 1.0]) * max(float(np.abs([x_m, y_m]).max()), verification.radius_m)
    x_label = f"axis {trace.axes[0]}"
    y_label = f"axis {trace.axes[1]}" if len(trace.axes) > 1 else "where a second axis would be"
    x, y = axis_over(x_label, [reach_m], "m"), axis_over(y_label, [reach_m], "m")
    canvas = Canvas(x=x, y=y, width=SQUARE, height=SQUARE)
    limit_m = _shape_limit_m(verification, trace.frequency_Hz)
    scale_m = limit_m
    if scale_m is None:
        scale_m = Limits().aligned_percent / 100.0 * 2.0 * verification.radius_m
    return Figure(
        title=f"Spiral of {number(trace.frequency_Hz, 'Hz')}: {METHOD_NAMES[trace.method]}",
        caption=f"Colour is the shape error: median {number(float(np.median(error_m)), 'm')}, "
        f"largest {number(float(error_m.max()), 'm')}.",
        guide="Good: the first colour everywhere. Bad: the last colours at the turning points.",
        canvas=canvas,
        layers=tuple(_shaded(canvas, x_m, y_m, error_m, scale_m)),
    )


def errors_in_time(verification: Verification) -> list[Figure]:
    """Draw the shape error along each spiral: the shipped controller, and in grey no control."""
    rates = dict.fromkeys(trace.frequency_Hz for trace in verification.traces)
    return [_error_in_time(rate, verification) for rate in rates]


def _error_in_time(frequency_Hz: float, verification: Verification) -> Figure:
    traces = [trace for trace in verification.traces if trace.frequency_Hz == frequency_Hz]
    shipped = set(verification.methods.values())
    traces.sort(key=lambda trace: trace.method in shipped)  # what ships is drawn on top
    along = [np.linspace(0.0, 100.0, len(trace.shape_error_m)) for trace in traces]
    logs = [np.log10(np.maximum(trace.shape_error_m, SMALLEST_m) / NANO) for trace in traces]
    limit_m = _shape_limit_m(verification, frequency_Hz)
    limits = [] if limit_m is None else [np.full(2, np.log10(limit_m / NANO))]
    x = axis_over("share of the path", along, "%")
    y = decades_over("shape error", [*logs, *limits], "nm")
    canvas = Canvas(x=x, y=y)
    layers = [
        canvas.line("model" if t.method in shipped else "grey", METHOD_NAMES[t.method], a, v)
        for t, a, v in zip(traces, along, logs, strict=True)
    ]
    rms_m = {
        row.method: row.aligned_rms_m
        for row in verification.comparison
        if row.frequency_Hz == frequency_Hz
    }
    sizes = "; ".join(
        f"{METHOD_NAMES[t.method]}: {number(rms_m[t.method], 'm')} rms" for t in reversed(traces)
    )
    sizes = f"{sizes[:1].upper()}{sizes[1:]}"
    baseline = "the dashed line" if limits else METHOD_NAMES[UNCOMPENSATED]
    return Figure(
        title=f"Shape error along the spiral of {number(frequency_Hz, 'Hz')}",
        caption=f"{sizes}; {_limit_clause(verification, frequency_Hz)}.",
        guide=f"Good: far below {baseline}. Bad: rising outwards, or a spike every turn.",
        canvas=canvas,
        layers=(
            *layers,
            *(canvas.line("limit", "limit, rms", np.array([0.0, 100.0]), v) for v in limits),
        ),
    )


def _shape_limit_m(verification: Verification, frequency_Hz: float) -> float | None:
    """Return the limit of the verdict on the spiral of a rate; None where there is none.

    Above ``Limits.judged_Hz`` a spiral is compared with no compensation only.
    """
    scenario = f"spiral, {frequency_Hz:g} Hz"
    percent = [
        v.limit for v in verification.verdicts if (v.name, v.scenario) == (SHAPE_ERROR, scenario)
    ]
    return percent[0] / 100.0 * 2.0 * verification.radius_m if percent else None


def _limit_clause(verification: Verification, frequency_Hz: float) -> str:
    """Return the limit of the shape error at a rate: a length, or a ratio to no compensation."""
    limit_m = _shape_limit_m(verification, frequency_Hz)
    if limit_m is not None:
        return f"limit {number(limit_m, 'm')} rms"
    scenario = f"spiral, {frequency_Hz:g} Hz"
    for verdict in verification.verdicts:
        if (verdict.name, verdict.scenario) == (SHAPE_RATIO, scenario):
            ratio, limit = significant(verdict.value), significant(verdict.limit)
            return f"ratio {ratio}, allowed {limit}; no limit in metres at this rate"
    return "no limit at this rate"


def _shaded(canvas: Canvas, x_m: Array, y_m: Array, error_m: Array, limit_m: float) -> list[Layer]:
    """Draw a curve in shades, by the parts of the limit its error reaches."""
    edges_m = [limit_m * share if np.isfinite(share) else np.inf for share in SHADES.values()]
    shade = np.searchsorted(edges_m, error_m)
    layers = []
    for index, (role, share) in enumerate(SHADES.items()):
        is_shade = shade == index
        if not is_shade.any():
            continue
        is_shade |= np.r_[False, is_shade[:-1]]  # up to where the next stretch begins
        name = f"up to {number(share * limit_m, 'm')}" if np.isfinite(share) else "more"
        x, y = np.where(is_shade, x_m, np.nan), np.where(is_shade, y_m, np.nan)
        layers.append(canvas.line(f"error-{role}", name, x, y))
    return layers


def motions(verification: Verification) -> tuple[Figure, ...]:
    """Draw the error against time after steps, which shows settling; spirals show the rest."""
    return tuple(
        _error(motion, verification) for motion in verification.motions if motion.scenario == STEPS
    )


def _error(motion: Motion, verification: Verification) -> Figure:
    reference_m = np.array(motion.reference_m)
    starts = np.arange(0, len(reference_m), AVERAGED, dtype=np.intp)
    time_s = np.linspace(0.0, motion.duration_s, len(reference_m), endpoint=False)[starts]
    errors = [
        (role, name, rms_from(starts, moved_m - reference_m))
        for role, name, moved_m in _runs(motion, verification)
    ]
    logs = [np.log10(np.maximum(error_m, SMALLEST_m) / NANO) for _, _, error_m in errors]
    x = axis_over("time", [time_s], "s")
    y = decades_over("distance from the reference", logs, "nm")
    canvas = Canvas(x=x, y=y)
    medians = "; ".join(
        f"{METHOD_NAMES[name]}: {number(float(np.median(error_m)), 'm')}"
        for _, name, error_m in reversed(errors)
    )
    return Figure(
        title=f"Axis {motion.axis}, {motion.scenario}: tracking error",
        caption=f"Median: {medians}.",
        guide=GUIDE_ERROR,
        canvas=canvas,
        layers=tuple(
            canvas.line(role, METHOD_NAMES[name], time_s, log)
            for (role, name, _), log in zip(errors, logs, strict=True)
        ),
    )


def _runs(motion: Motion, verification: Verification) -> list[tuple[str, str, Array]]:
    """Return role, method and path; the shipped controller last, because it is drawn on top."""
    runs = [("model", verification.methods[motion.axis], np.array(motion.shipped_m))]
    if motion.uncompensated_m:
        runs.insert(0, ("grey", "none", np.array(motion.uncompensated_m)))
    return runs
