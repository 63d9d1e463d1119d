"""The compiled controller run against the stage: methods by frequency, paths, verdicts."""

from collections.abc import Sequence

import numpy as np

from piezoid.design.design_statements import guaranteed_error_m
from piezoid.runtime.schema import METHOD_NAMES
from piezoid.verification.criteria import Verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.rebuild import Proof
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid.verification.verification import ComparisonRow, Verification
from piezoid_reports.chart import Canvas, decades_over
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Part, Section, Table, count_of, folded, with_rows
from piezoid_reports.quantities import number, significant
from piezoid_reports.spirals import errors_in_time, motions, spiral

MAX_VERDICTS = 10  # in the table; all that failed are shown
STROKES = {"mpi_dob": "model", "none": "limit", "dob": "rising", "mpi": "trend"}


def render(page: Page) -> Section | None:
    """Return how the compiled controllers behave on the identified stage, if they were run."""
    verification = page.verification
    if verification is None:
        return None
    return Section(
        anchor="verification",
        title="Verification",
        lead="The compiled controller, run against the identified stage with converters and "
        "noise, and against other stages that the recordings allow.",
        parts=(
            *_figures(page, verification),
            *with_rows(
                _bounds(verification),
                _currents(verification),
                _verdicts(verification.verdicts),
                _proofs(verification.proofs),
                _limit_proofs(verification.limit_proofs),
            ),
        ),
    )


def _figures(page: Page, verification: Verification) -> list[Part]:
    shipped = set(verification.methods.values())
    fastest_Hz = max((trace.frequency_Hz for trace in verification.traces), default=0.0)
    spirals = [
        spiral(trace, verification)
        for trace in verification.traces
        if trace.method in shipped and trace.frequency_Hz == fastest_Hz
    ]
    details = [*spirals, *motions(verification)]
    parts: list[Part] = [_shape_figure(verification)] if verification.comparison else []
    parts += errors_in_time(verification)[-1:]
    parts += folded(f"Steps and spiral: {count_of(len(details), 'figure')}", details)
    return parts + ([_table(page, verification)] if verification.comparison else [])


def _shape_figure(verification: Verification) -> Figure:
    """Draw the shape error of every method over the frequency, in logarithms."""
    methods = list(dict.fromkeys(row.method for row in verification.comparison))
    curves = {m: [row for row in verification.comparison if row.method == m] for m in methods}
    points = {
        m: (
            np.log10([row.frequency_Hz for row in rows]),
            np.log10([max(row.aligned_rms_m, 1e-12) * 1e9 for row in rows]),
        )
        for m, rows in curves.items()
    }
    x = decades_over("frequency", [p[0] for p in points.values()], "Hz")
    y = decades_over("shape error", [p[1] for p in points.values()], "nm")
    canvas = Canvas(x=x, y=y)
    layers = [canvas.line(STROKES[m], METHOD_NAMES[m], *points[m]) for m in methods]
    shipped = curves[methods[0]]
    return Figure(
        title="Shape error on spirals, method by method",
        caption=f"{METHOD_NAMES[methods[0]].capitalize()}: "
        f"{number(shipped[0].aligned_rms_m, 'm')} rms at "
        f"{number(shipped[0].frequency_Hz, 'Hz')}. Shape error: distance from the path after the "
        "best common delay.",
        guide="Good: the controller that ships lies lowest. Bad: it crosses another method.",
        canvas=canvas,
        layers=tuple(layers),
    )


def _table(page: Page, verification: Verification) -> Table:
    """Return the error of each method at each rate, and the guaranteed error of what ships."""
    rates_Hz = sorted({row.frequency_Hz for row in verification.comparison})
    by_method: dict[str, dict[float, ComparisonRow]] = {}
    for row in verification.comparison:
        by_method.setdefault(row.method, {})[row.frequency_Hz] = row
    rows = []
    for method, of_method in by_method.items():
        errors = [of_method.get(rate_Hz) for rate_Hz in rates_Hz]
        rows.append(
            (METHOD_NAMES[method], *("" if e is None else number(e.rms_m, "m") for e in errors))
        )
        bounds = ["" if e is None else _guaranteed(page, verification, e) for e in errors]
        if any(bounds) and method in verification.methods.values():
            rows.append((f"guaranteed: {METHOD_NAMES[method]}", *bounds))
    return Table(
        caption="Simulated tracking error on a spiral of radius "
        f"{number(verification.radius_m, 'm')}, rms, delay included, by turns per second. Not "
        "covered: faster than the certificate.",
        columns=("method", *(number(rate_Hz, "Hz") for rate_Hz in rates_Hz)),
        rows=tuple(rows),
    )


def _bounds(verification: Verification) -> Table:
    """Return how large errors may be beside how large they are, where that was asked."""
    rows = []
    for row in verification.bounds:
        bound = "none" if row.bound_m is None else number(row.bound_m, "m")
        rows.append(
            (
                row.axis,
                number(row.slew_m_per_s, "m/s"),
                bound + (", not on all stages drawn" if row.is_exceeded else ""),
                number(row.probable_m, "m") if np.isfinite(row.probable_m) else "too few runs",
                number(row.worst_found_m, "m"),
                number(row.simulated_m, "m"),
            )
        )
    share = max((1.0 - row.probability for row in verification.bounds), default=0.0)
    return Table(
        caption="Largest error within half a second. Bounded: proven on the conditions of the "
        f"certificate. Probable: exceeded with a probability below {100.0 * share:.2g} % on "
        "stages that the recordings allow. Worst found: by search. Simulated: median.",
        columns=("axis", "at most", "bounded", "probable", "worst found", "simulated"),
        rows=tuple(rows),
    )


def _guaranteed(page: Page, verification: Verification, row: ComparisonRow) -> str:
    """Return the guaranteed distance from the path at its speed, from the axes' certificates."""
    loops = [
        (axis.axis, loop.certificate)
        for axis in (page.design.axes if page.design is not None else ())
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
    return number(together_m, "m") if np.isfinite(together_m) else "not covered"


def _currents(verification: Verification) -> Table:
    return Table(
        caption="The tip over a surface of 0.1 nm rms. Largest current: over its set point.",
        columns=("path", "std of ln i", "height rms", "largest current", "samples retracted"),
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


def _verdicts(verdicts: Sequence[Verdict]) -> Table:
    """Return the checks by name, each with the scenario that comes closest to its limit."""
    by_name: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        by_name.setdefault(verdict.name, []).append(verdict)
    worst = [max(repetitions, key=_closeness) for repetitions in by_name.values()]
    worst.sort(key=_closeness, reverse=True)
    n_passed = sum(verdict.passed for verdict in verdicts)
    return Table(
        caption=f"Checks: {n_passed} of {len(verdicts)} passed. The closest to their limits, "
        "each in its worst scenario; verification.json has all.",
        columns=("check (scenarios)", "worst in", "value", "limit", "result"),
        rows=tuple(
            (
                f"{verdict.name} ({len(by_name[verdict.name])})",
                verdict.scenario,
                _measured(verdict, verdict.value),
                _measured(verdict, verdict.limit),
                "passed" if verdict.passed else "failed",
            )
            for verdict in worst[: max(MAX_VERDICTS, sum(not v.passed for v in worst))]
        ),
        is_open=n_passed < len(verdicts),
    )


def _closeness(verdict: Verdict) -> float:
    """Return the value of a verdict in units of its limit; a limit of zero has no scale."""
    if verdict.limit:
        return verdict.value / verdict.limit
    return np.inf if verdict.value > 0.0 else 0.0


def _measured(verdict: Verdict, value: float) -> str:
    """Return a number of a verdict with its unit."""
    if verdict.unit in ("s", "m"):
        return number(value, verdict.unit)
    return f"{significant(value)} {'' if verdict.unit == '1' else verdict.unit}".strip()


def _proofs(proofs: Sequence[Proof]) -> Table:
    return Table(
        caption="The bundle, compiled again and compared bit for bit.",
        columns=("build", "samples", "differing", "instructions a sample"),
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
            for proof in proofs
        ),
    )


def _limit_proofs(proofs: Sequence[LimitProof]) -> Table:
    return Table(
        caption="Proofs for every input, NaN and infinities included.",
        columns=("axis", "verdict", "what holds, or where it was not shown", "by", "took"),
        rows=tuple(
            (
                f"{proof.axis}, {proof.precision}",
                proof.verdict,
                "; ".join(proof.alarms or proof.claims),
                proof.tool,
                f"{proof.seconds} s" if proof.tool else "",
            )
            for proof in proofs
        ),
    )
