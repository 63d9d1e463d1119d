"""Compiled controllers on the simulated stage: errors by method, spirals, verdicts, proofs."""

from collections.abc import Sequence

import numpy as np

from piezoid.design.certificate import guaranteed_error_m
from piezoid.formatting import count_of
from piezoid.runtime.schema import METHOD_NAMES
from piezoid.verification.criteria import SHAPE_ERROR, Limits, Verdict
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid.verification.tracking import SpiralTrace, rms_from
from piezoid.verification.verification import ComparisonRow, Verification
from piezoid_reports.chart import Canvas, axis_over, decades_over
from piezoid_reports.page import Page, moving_axes
from piezoid_reports.parts import Figure, Part, Section, Table, folded, with_rows
from piezoid_reports.quantities import number, significant

MAX_VERDICTS = 10  # in the table, which also shows every failed verdict
STROKES = {"mpi_dob": "model", "none": "limit", "dob": "rising", "mpi": "trend"}
AVERAGED = 5  # samples: a zero crossing of a single sample is a deep notch on a logarithmic axis
GUIDE_ERROR = "Good: the error falls to the noise after each turn or step. Bad: a slow tail."

SQUARE = 440  # pixels
NANO = 1e-9
NOT_COVERED = "not covered"
STEPS = "steps"  # scenario with an error plotted against time
MIN_ERROR_m = 1e-12  # smallest error on a logarithmic axis
SHADES = {"measured": 0.1, "good": 1.0 / 3.0, "middling": 1.0, "bad": np.inf}  # of the limit


def render(page: Page) -> Section | None:
    """Return errors, spirals, verdicts and proofs of the compiled controllers."""
    verification = page.verification
    if verification is None:
        return None
    shipped = set(verification.methods.values())
    fastest_Hz = max((trace.frequency_Hz for trace in verification.traces), default=0.0)
    spirals = [
        spiral(trace, verification)
        for trace in verification.traces
        if trace.method in shipped and trace.frequency_Hz == fastest_Hz
    ]
    details = [*spirals, *motions(verification)]
    figures: list[Part] = [_shape_figure(verification)] if verification.comparison else []
    figures += folded(f"Steps and spiral: {count_of(len(details), 'figure')}", details)
    figures += with_rows(comparison_table(page, verification))
    currents = Table(
        caption="Tip over a surface of 0.1 nm rms. Largest current: relative to the set point.",
        columns=("path", "std of ln i", "height rms", "largest current", "retracted samples"),
        rows=tuple(
            (
                row.scenario,
                significant(row.ln_current_std),
                number(row.height_rms_m, "m"),
                significant(row.largest_ratio),
                str(row.retracted_samples),
            )
            for row in verification.currents
        ),
    )
    return Section(
        anchor="verification",
        title="Verification",
        lead="The compiled controller on the identified stage with converters and noise, and on "
        "other stages that are consistent with the recordings.",
        parts=(
            *figures,
            *with_rows(
                bounds_table(verification),
                currents,
                _verdicts(verification.verdicts),
                *proof_tables(verification),
            ),
        ),
    )


def _shape_figure(verification: Verification) -> Figure:
    curves: dict[str, list[ComparisonRow]] = {}
    for row in verification.comparison:
        curves.setdefault(row.method, []).append(row)
    points = {
        method: (
            np.log10([row.frequency_Hz for row in rows]),
            np.log10([max(row.aligned_rms_m, MIN_ERROR_m) * 1e9 for row in rows]),
        )
        for method, rows in curves.items()
    }
    x = decades_over("frequency", [across for across, _ in points.values()], "Hz")
    y = decades_over("shape error", [up for _, up in points.values()], "nm")
    canvas = Canvas(x=x, y=y)
    shipped = verification.comparison[0]
    best = {}  # by frequency, the row with the smallest shape error
    for row in sorted(verification.comparison, key=lambda row: -row.aligned_rms_m):
        best[row.frequency_Hz] = row
    crossings = [
        f"at {number(rate_Hz, 'Hz')} {METHOD_NAMES[row.method]} has the smaller shape error, "
        f"{number(row.aligned_rms_m, 'm')}"
        for rate_Hz, row in sorted(best.items())
        if row.method != shipped.method
    ]
    crossing = f" The curves cross: {'; '.join(crossings)}." if crossings else ""
    return Figure(
        title="Shape error on spirals by method",
        caption=f"{METHOD_NAMES[shipped.method].capitalize()}: "
        f"{number(shipped.aligned_rms_m, 'm')} rms at {number(shipped.frequency_Hz, 'Hz')}. "
        "Shape error: distance from the path after the best common delay; of a slow spiral "
        f"nearly the tracking error of the table.{crossing}",
        guide="Good: the shipped controller has the smallest error at your rates. Bad: another "
        "method is clearly better there. The verdict in the summary does not contain this "
        "comparison.",
        canvas=canvas,
        layers=tuple(canvas.line(STROKES[m], METHOD_NAMES[m], *points[m]) for m in points),
    )


def comparison_table(page: Page, verification: Verification) -> Table:
    """Return the error of each method at each rate, and the guaranteed error if it ships."""
    comparison = {(row.method, row.frequency_Hz): row for row in verification.comparison}
    rates_Hz = sorted({rate_Hz for _, rate_Hz in comparison})
    rows, notes = [], ""
    for method in dict.fromkeys(method for method, _ in comparison):
        errors = [comparison.get((method, rate_Hz)) for rate_Hz in rates_Hz]
        rows.append(
            (METHOD_NAMES[method], *("" if e is None else number(e.rms_m, "m") for e in errors))
        )
        bounds = ["" if e is None else _guaranteed(page, verification, e) for e in errors]
        if any(bounds) and method in verification.methods.values():
            reason, *further = dict.fromkeys(filter(None, bounds))
            if further or reason[0].isdigit():
                rows.append((f"guaranteed: {METHOD_NAMES[method]}", *bounds))
            else:  # the same at every speed
                notes += f" Guaranteed error of {METHOD_NAMES[method]}: {reason}."
    if any(NOT_COVERED in row for row in rows):
        notes += " Not covered: the spiral is faster than the guarantee allows."
    return Table(
        caption="Simulated tracking error on a spiral of radius "
        f"{number(verification.radius_m, 'm')}, rms, delay included, by turns per second; "
        f"distance in the plane, {moving_axes(verification)}.{notes}",
        columns=("method", *(number(rate_Hz, "Hz") for rate_Hz in rates_Hz)),
        rows=tuple(rows),
    )


def bounds_table(verification: Verification) -> Table:
    """Return bounded, probable and simulated largest errors, if bounds were requested."""
    rows = []
    for row in verification.bounds:
        bound = "no useful bound" if row.bound_m is None else number(row.bound_m, "m")
        rows.append(
            (
                row.axis,
                number(row.slew_m_per_s, "m/s"),
                bound + (", exceeded on some sampled stages" if row.is_exceeded else ""),
                number(row.probable_m, "m") if np.isfinite(row.probable_m) else "too few runs",
                number(row.worst_found_m, "m"),
                number(row.simulated_m, "m"),
            )
        )
    share = max((1.0 - row.probability for row in verification.bounds), default=0.0)
    return Table(
        caption="Largest error within half a second, by the speed of the reference. Guaranteed: "
        "proven under its conditions, with sensor noise. Probable: exceeded with a probability "
        f"below {100.0 * share:.2g} % on stages that are consistent with the recordings. Worst "
        "found: the worst of all such stages that a search found, also beyond the probable error. "
        "Simulated: median on the identified stage.",
        columns=("axis", "speed up to", "guaranteed", "probable", "worst found", "simulated"),
        rows=tuple(rows),
    )


def _guaranteed(page: Page, verification: Verification, row: ComparisonRow) -> str:
    """Return the guaranteed distance from the path at its speed, from all certificates."""
    loops = [
        (axis.axis, loop.certificate)
        for axis in page.axis_designs
        for loop in axis.loops
        if axis.axis in verification.methods
        and axis.axis in page.model.axes
        and loop.method == row.method
    ]
    if not verification.passed or not loops:
        return ""
    speed_m_per_s = spiral_speed_m_per_s(row.frequency_Hz, verification.radius_m)
    bounds_m = []
    for axis, certificate in loops:
        bound_m = guaranteed_error_m(certificate, page.model.axes[axis])
        if certificate is None or isinstance(bound_m, str):
            return str(bound_m)
        bounds_m.append(certificate.guaranteed_at(speed_m_per_s))
    together_m = float(np.hypot.reduce(bounds_m))
    return number(together_m, "m") if np.isfinite(together_m) else NOT_COVERED


def _verdicts(verdicts: Sequence[Verdict]) -> Table:
    """Return the checks by name, each with the scenario closest to its limit."""

    def closeness(verdict: Verdict) -> float:
        if verdict.limit:
            return verdict.value / verdict.limit
        return np.inf if verdict.value > 0.0 else 0.0

    def with_unit(verdict: Verdict, value: float) -> str:
        if verdict.unit in ("s", "m"):
            return number(value, verdict.unit)
        return f"{significant(value)} {'' if verdict.unit == '1' else verdict.unit}".strip()

    by_name: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        by_name.setdefault(verdict.name, []).append(verdict)
    worst = [max(repetitions, key=closeness) for repetitions in by_name.values()]
    worst.sort(key=closeness, reverse=True)
    n_passed = sum(verdict.passed for verdict in verdicts)
    return Table(
        caption=f"Checks: {n_passed} of {len(verdicts)} passed. Those closest to their limits, "
        "each in its worst scenario; verification.json lists all.",
        columns=("check (scenarios)", "worst scenario", "value", "limit", "result"),
        rows=tuple(
            (
                f"{verdict.name} ({len(by_name[verdict.name])})",
                verdict.scenario,
                with_unit(verdict, verdict.value),
                with_unit(verdict, verdict.limit),
                "passed" if verdict.passed else "failed",
            )
            for verdict in worst[: max(MAX_VERDICTS, sum(not v.passed for v in worst))]
        ),
        is_open=n_passed < len(verdicts),
    )


def proof_tables(verification: Verification) -> tuple[Table, Table]:
    """Return the comparisons of builds bit for bit, and the proofs of the limits."""
    builds = Table(
        caption="The bundle, compiled again and compared bit for bit.",
        columns=("build", "samples", "differing", "instructions per sample"),
        rows=tuple(
            (
                proof.build,
                str(proof.samples) if proof.is_built else "not built here",
                str(proof.differing) if proof.is_built else "",
                ", ".join(
                    f"{axis}: {count:.0f}"
                    for axis, count in (proof.instructions_per_sample or {}).items()
                ),
            )
            for proof in verification.proofs
        ),
    )
    limits = Table(
        caption="Proofs for every input, including NaN and infinities.",
        columns=("axis", "verdict", "claims, or locations without proof", "tool", "duration"),
        rows=tuple(
            (
                f"{proof.axis}, {proof.precision}",
                proof.verdict,
                "; ".join(proof.alarms or proof.claims),
                proof.tool,
                f"{proof.seconds} s" if proof.tool else "",
            )
            for proof in verification.limit_proofs
        ),
    )
    return builds, limits


def spiral(trace: SpiralTrace, verification: Verification) -> Figure:
    """Draw one path, coloured by its shape error."""
    x_m, y_m, error_m = (np.array(v) for v in (trace.x_m, trace.y_m, trace.shape_error_m))
    reach_m = np.array([-1.0, 1.0]) * max(float(np.abs([x_m, y_m]).max()), verification.radius_m)
    x_label = f"axis {trace.axes[0]}"
    y_label = f"axis {trace.axes[1]}" if len(trace.axes) > 1 else "reference of a second axis"
    x, y = axis_over(x_label, [reach_m], "m"), axis_over(y_label, [reach_m], "m")
    canvas = Canvas(x=x, y=y, width=SQUARE, height=SQUARE)
    # Above ``Limits.judged_Hz`` the only limit is relative to the error without compensation.
    check = SHAPE_ERROR, f"spiral, {trace.frequency_Hz:g} Hz"
    limits = (v.limit for v in verification.verdicts if (v.name, v.scenario) == check)
    limit_m = next(limits, Limits().aligned_percent) / 100.0 * 2.0 * verification.radius_m
    # The shade of a sample depends on the fraction of the limit that its error reaches.
    shade = np.searchsorted([limit_m * share for share in SHADES.values()], error_m)
    layers = []
    for index, (role, share) in enumerate(SHADES.items()):
        is_shade = shade == index
        if not is_shade.any():
            continue
        is_shade |= np.r_[False, is_shade[:-1]]  # continue to the start of the next segment
        name = f"up to {number(share * limit_m, 'm')}" if np.isfinite(share) else "more"
        across_m, up_m = np.where(is_shade, x_m, np.nan), np.where(is_shade, y_m, np.nan)
        layers.append(canvas.line(f"error-{role}", name, across_m, up_m))
    return Figure(
        title=f"Spiral of {number(trace.frequency_Hz, 'Hz')}: {METHOD_NAMES[trace.method]}",
        caption=f"Colour is the shape error: median {number(float(np.median(error_m)), 'm')}, "
        f"largest {number(float(error_m.max()), 'm')}.",
        guide="Good: the first colour everywhere. Bad: the last two colours at turning points.",
        canvas=canvas,
        layers=tuple(layers),
    )


def motions(verification: Verification) -> tuple[Figure, ...]:
    """Draw the error against time after steps, which shows the settling of each axis."""
    figures = []
    for motion in verification.motions:
        if motion.scenario != STEPS:
            continue
        reference_m = np.array(motion.reference_m)
        starts = np.arange(0, len(reference_m), AVERAGED, dtype=np.intp)
        time_s = np.linspace(0.0, motion.duration_s, len(reference_m), endpoint=False)[starts]
        # The last curve is drawn on top.
        runs = [("model", verification.methods[motion.axis], motion.shipped_m)]
        if motion.uncompensated_m:
            runs.insert(0, ("grey", "none", motion.uncompensated_m))
        errors = [
            (role, name, rms_from(starts, np.array(position_m) - reference_m))
            for role, name, position_m in runs
        ]
        logs = [np.log10(np.maximum(error_m, MIN_ERROR_m) / NANO) for _, _, error_m in errors]
        x = axis_over("time", [time_s], "s")
        y = decades_over("distance from the reference", logs, "nm")
        canvas = Canvas(x=x, y=y)
        medians = "; ".join(
            f"{METHOD_NAMES[name]}: {number(float(np.median(error_m)), 'm')}"
            for _, name, error_m in reversed(errors)
        )
        figures.append(
            Figure(
                title=f"Axis {motion.axis}, {motion.scenario}: tracking error",
                caption=f"Median: {medians}.",
                guide=GUIDE_ERROR,
                canvas=canvas,
                layers=tuple(
                    canvas.line(role, METHOD_NAMES[name], time_s, log)
                    for (role, name, _), log in zip(errors, logs, strict=True)
                ),
            )
        )
    return tuple(figures)
