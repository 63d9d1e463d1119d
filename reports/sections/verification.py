"""The compiled controller run against the stage: methods by frequency, paths, verdicts."""

import numpy as np

from piezoid.verification.criteria import Verdict
from piezoid.verification.limit_proof import LimitProof
from piezoid.verification.proof import Proof
from piezoid.verification.scenarios import spiral_speed_m_per_s
from piezoid.verification.verification import ComparisonRow, ErrorBound, Verification
from piezoid_reports.chart import Canvas, decades_over
from piezoid_reports.page import Figure, Fold, Heading, Page, Part, Prose, Section, Table
from piezoid_reports.quantities import significant, told
from piezoid_reports.spirals import METHODS, errors_in_time, motions, spiral

STROKES = {"mpi_dob": "model", "none": "limit", "dob": "rising", "mpi": "trend"}
_EVERY = "all"


def render(page: Page) -> Section | None:
    """Return the chapter, where what ships was run."""
    found = page.verification
    if found is None:
        return None
    return Section(
        anchor="verification",
        title="Verification",
        lead="The compiled controller that ships, with the parameters that ship, run against the "
        "identified stage: converters, noise, and stages the recordings allow as well. Every axis "
        "is led to the middle of its references first. Nobody knows how a stage was driven before "
        "that: of two pasts over its whole range spirals show the worse.",
        parts=tuple(_parts(page, found)),
    )


def _parts(page: Page, found: Verification) -> list[Part]:
    return [
        _summary(found),
        *_figures(page, found),
        *_currents(found),
        Heading(text="Verdicts"),
        _verdicts(found),
        *_proofs(found.proofs),
        *_limit_proofs(found.limit_proofs),
    ]


def _summary(found: Verification) -> Prose:
    failed = [verdict for verdict in found.verdicts if not verdict.passed]
    differing = [proof.build for proof in found.proofs if not proof.passed]
    ships = ", ".join(f"axis {axis}: {METHODS[m]}" for axis, m in found.methods.items())
    ships = f"What ships: {ships}"
    text = (
        f"{len(found.verdicts) - len(failed)} of {len(found.verdicts)} verdicts passed. {ships}."
    )
    if failed:
        text += " Failed: " + "; ".join(f"{v.name} ({v.scenario})" for v in failed) + "."
    unproved = [f"axis {p.axis} in {p.precision}" for p in found.limit_proofs if not p.passed]
    if unproved:
        text += " Not proved: " + "; ".join(unproved) + "."
    if differing:
        text += " Builds that gave other bits: " + "; ".join(differing) + "."
    return Prose(text=text, tone="good" if found.passed else "bad")


def _figures(page: Page, found: Verification) -> list[Part]:
    """Return all pictures beside each other, the table of the comparison after them."""
    compared = [_shape_figure(found)] if found.comparison else []
    drawn = tuple(spiral(trace, found) for trace in found.traces)
    followed = motions(found)
    return [
        *compared,
        *errors_in_time(found),
        *(
            [Fold(summary=f"Raster and steps in time: {_number(followed)}", parts=followed)]
            if followed
            else []
        ),
        *(
            [Fold(summary=f"Spirals as they were run: {_number(drawn)}", parts=drawn)]
            if drawn
            else []
        ),
        *([_table(page, found)] if found.comparison else []),
        *_bounds(found),
    ]


def _number(drawn: tuple[Figure, ...]) -> str:
    return "1 figure" if len(drawn) == 1 else f"{len(drawn)} figures"


def _shape_figure(found: Verification) -> Figure:
    """Draw the shape error of every method over the frequency, in logarithms."""
    methods = list(dict.fromkeys(row.method for row in found.comparison))
    curves = {m: [row for row in found.comparison if row.method == m] for m in methods}
    points = {
        m: (
            np.log10([row.frequency_Hz for row in rows]),
            np.log10([max(row.aligned_rms_m, 1e-12) * 1e9 for row in rows]),
        )
        for m, rows in curves.items()
    }
    x = decades_over("turns a second", [p[0] for p in points.values()], "Hz")
    y = decades_over("shape error", [p[1] for p in points.values()], "nm")
    canvas = Canvas(x=x, y=y)
    layers = [canvas.line(STROKES[m], METHODS[m], *points[m]) for m in methods]
    shipped = curves[methods[0]]
    return Figure(
        title="Shape error on spirals, method by method",
        numbers=f"{METHODS[methods[0]]}: {told(shipped[0].aligned_rms_m, 'm')} at "
        f"{told(shipped[0].frequency_Hz, 'Hz')}, {told(shipped[-1].aligned_rms_m, 'm')} at "
        f"{told(shipped[-1].frequency_Hz, 'Hz')}, rms after the best common delay; radius "
        f"{told(found.radius_m, 'm')}.",
        look="Good: what ships lies lowest at every frequency that will be used. Bad: it crosses "
        "another method: above that frequency the other one is better. Without feedback the past "
        "of the stage decides: drive it over its whole range before you rely on the inverse "
        "alone.",
        canvas=canvas,
        layers=tuple(layers),
    )


def _table(page: Page, found: Verification) -> Table:
    further = {(row.method, row.frequency_Hz): row for row in found.spirals}
    rows = []
    for row in found.comparison:
        spiral = further[row.method, row.frequency_Hz]
        pitch = spiral.pitch_error
        rows.append(
            (
                told(row.frequency_Hz, "Hz"),
                row.method,
                told(row.rms_m, "m"),
                told(row.rms_percent, "%"),
                told(row.max_m, "m"),
                _guaranteed(page, found, row),
                told(row.aligned_rms_m, "m"),
                told(row.delay_s, "s"),
                told(spiral.radial_rms_m, "m"),
                "" if pitch is None else told(100.0 * pitch, "%"),
            )
        )
    return Table(
        caption=f"Spirals of radius {told(found.radius_m, 'm')}, by turns a second and method: "
        "distance from the path, rms, in percent of the diameter, and largest after the start "
        "from rest; shape: what the best common delay leaves between start and end, and that "
        "delay (negative: early); error of the radius; scatter of "
        f"the distance between turns. {_methods(found)}.",
        columns=(
            *("turns a second", "method", "rms", "of diameter", "largest", "guaranteed"),
            *("shape rms", "delay", "radial rms", "pitch"),
        ),
        rows=tuple(rows),
    )


def _bounds(found: Verification) -> list[Part]:
    """Return how large errors may be beside how large they are, where that was asked."""
    if not found.bounds:
        return []
    rows = tuple(
        (
            row.axis,
            told(row.slew_m_per_s, "m/s"),
            _bounded(row),
            told(row.probable_m, "m") if np.isfinite(row.probable_m) else "too few runs",
            told(row.worst_found_m, "m"),
            told(row.simulated_m, "m"),
        )
        for row in found.bounds
    )
    probability = f"{100.0 * found.bounds[0].probability:g} %"
    table = Table(
        caption="The largest error of half a second, for references (or the surface under a tip) "
        "that are never faster than said. Bounded: what the certificate proves on its conditions, "
        "which stages farther from the model's class than rows left out do not meet; of a tip "
        "what its linear loop can show, each with three standard deviations of noise. "
        f"Probable: below this with a probability of {probability}, on stages like those that the "
        "recordings allow; it is no guarantee. Worst found: by a search over references, pasts "
        "and stages. Simulated: on the identified stage, in the median.",
        columns=("axis", "at most", "bounded", "probable", "worst found", "simulated"),
        rows=rows,
    )
    return [Heading(text="How large errors may be"), table]


def _bounded(row: ErrorBound) -> str:
    if row.bound_m is None:
        return "none"
    return told(row.bound_m, "m") + (", not on all stages drawn" if row.is_exceeded else "")


def _guaranteed(page: Page, found: Verification, row: ComparisonRow) -> str:
    """Return what both axes' certificates say of the distance from the path at its speed."""
    loops = [
        loop
        for axis in (page.design.axes if page.design is not None else ())
        for loop in axis.loops
        if axis.axis in found.methods and loop.method == row.method
    ]
    proven = [loop.certificate for loop in loops if loop.certificate is not None]
    if not found.passed or not proven or not all(one.is_guaranteed for one in proven):
        return ""
    speed_m_per_s = spiral_speed_m_per_s(row.frequency_Hz, found.radius_m)
    bounds_m = [one.guaranteed_at(speed_m_per_s) for one in proven]
    bound_m = float(np.hypot.reduce(bounds_m))
    return told(bound_m, "m") if bound_m < 2.0 * found.radius_m else ""


def _methods(found: Verification) -> str:
    """Say in words what the short names of the table stand for."""
    short = dict.fromkeys(row.method for row in found.comparison)
    return "; ".join(f"{name}: {METHODS[name]}" for name in short)


def _currents(found: Verification) -> list[Part]:
    if not found.currents:
        return []
    rows = tuple(
        (
            row.scenario,
            significant(row.ln_current_std),
            told(row.height_rms_m, "m"),
            significant(row.largest_ratio),
            str(row.retracted_samples),
        )
        for row in found.currents
    )
    return [
        Heading(text="The tip over a rough surface"),
        Table(
            caption="The tunnelling loop while the other axes take the tip along their path, over "
            "a surface of 0.1 nm rms: scatter of the logarithm of the current, the same as a "
            "height, and the largest current over its set point.",
            columns=("path", "std of ln i", "height rms", "largest current", "samples retracted"),
            rows=rows,
        ),
    ]


def _verdicts(found: Verification) -> Table:
    ordered = sorted(found.verdicts, key=lambda verdict: verdict.passed)
    return Table(
        caption="Every verdict with its limit, failed ones first. Limits are defaults unless "
        "limits.toml or [verification] in lab.toml says otherwise.",
        columns=("what", "in", "found", "limit", "unit", "verdict"),
        rows=tuple(_verdict_row(verdict) for verdict in ordered),
    )


def _verdict_row(verdict: Verdict) -> tuple[str, ...]:
    return (
        verdict.name,
        "every run" if verdict.scenario == _EVERY else verdict.scenario,
        _measured(verdict, verdict.value),
        _measured(verdict, verdict.limit),
        "" if verdict.unit in ("1", "s", "m") else verdict.unit,
        "passed" if verdict.passed else "failed",
    )


def _measured(verdict: Verdict, value: float) -> str:
    """Return a number of a verdict; times and distances carry their unit."""
    return told(value, verdict.unit) if verdict.unit in ("s", "m") else significant(value)


def _proofs(proofs: tuple[Proof, ...]) -> list[Part]:
    if not proofs:
        return []
    rows = tuple(
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
    )
    return [
        Heading(text="The same bits from other builds"),
        Table(
            caption="The bundle compiled again and stepped through the same inputs.",
            columns=("build", "samples", "differing", "instructions a sample"),
            rows=rows,
        ),
    ]


def _limit_proofs(proofs: tuple[LimitProof, ...]) -> list[Part]:
    if not proofs:
        return []
    rows = tuple(
        (
            f"{proof.axis}, {proof.precision}",
            proof.verdict,
            "; ".join(proof.alarms or proof.claims),
            proof.tool,
            f"{proof.seconds} s" if proof.tool else "",
        )
        for proof in proofs
    )
    return [
        Heading(text="Proved of every input"),
        Table(
            caption="The C of the bundle with these parameters: any reference and any reading, "
            "NaN and the infinities included, for any number of samples.",
            columns=("axis", "verdict", "what holds, or where it was not shown", "by", "took"),
            rows=rows,
        ),
    ]
