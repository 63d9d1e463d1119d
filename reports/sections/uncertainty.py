"""The uncertainty budget: what a displacement is known to, and what that is made of."""

import math

import numpy as np

from piezoid.formatting import Scale
from piezoid.identification.displacement_budget import DisplacementBudget, displacement_budget
from piezoid.numerics.uncertainty_budget import Contribution
from piezoid_reports.chart import Axis, Canvas, axis_over
from piezoid_reports.page import Figure, Listing, Page, Part, Prose, Section, Table, axis_heading
from piezoid_reports.quantities import percent, significant, told

SHAPES = {
    "normal": "normal",
    "rectangular": "rectangular",
    "heavy": "heavy-tailed (Student's t, {tail} degrees of freedom)",
}
DECLARED = {
    "sensor_gain_relative": "the gain of the sensor (its certificate)",
    "sensor_linearity_m": "the linearity of the sensor (its data sheet)",
    "tilt_rad": "the angle between the sensor's axis and the motion",
    "temperature_range_K": "the temperature of the room",
    "expansion_m_per_K": "the expansion that the sensor sees",
}
LOOK = (
    "Read upwards: so many cases in a hundred have an error below that. Good: both curves rise "
    "steeply and end left of the certified bound. Bad: the curve of the largest error goes on far "
    "to the right (a heavy tail: find what makes it), or both begin far from zero (a zero, a gain "
    "or a lag that is not known)."
)


def render(page: Page) -> Section | None:
    """Return a budget for each axis to which the model applies."""
    parts: list[Part] = []
    for axis in page.axes:
        if not axis.verdict.applies:
            continue
        found = displacement_budget(axis, page.lab)
        parts += [axis_heading(axis), _sentence(found), _table(found), *_unknown(found)]
        parts.append(_figure(found, axis.certificate.bound_m))
    if not parts:
        return None
    return Section(
        anchor="uncertainty",
        title="Uncertainty budget",
        lead="How well a displacement that the model predicts is known, by the Guide to the "
        "Expression of Uncertainty in Measurement: type A from the recordings, type B from "
        "certificates, and the largest error of many positions by drawing them.",
        parts=tuple(parts),
    )


def _sentence(found: DisplacementBudget) -> Prose:
    held = found.budget
    low_m, high_m = held.largest
    return Prose(
        text=f"Axis {found.axis}: a single position at the end of the range is known to "
        f"± {told(held.expanded, 'm')} (95 %: standard uncertainty {told(held.combined, 'm')}, "
        f"coverage factor {significant(held.coverage_factor)} at "
        f"{_freedom(held.freedom)} degrees of freedom). Propagating the distributions instead "
        f"gives ± {told(held.propagated, 'm')}. The largest error of {held.positions} independent "
        f"positions lies between {told(low_m, 'm')} and {told(high_m, 'm')} with 95 % "
        f"probability ({held.draws} draws)."
    )


def _table(found: DisplacementBudget) -> Table:
    held = found.budget
    rows = [_row(found, one) for one in sorted(held.contributions, key=lambda c: -c.standard)]
    rows.append(("together", "", "", told(held.combined, "m"), _freedom(held.freedom), "100 %"))
    return Table(
        caption=f"Axis {found.axis}: contributions, largest first, at "
        f"{told(found.at_m, 'm')} from the middle of the range. The residual counts whole, as "
        f"for a single position.{_zero(found)}",
        columns=("source", "type", "shape", "standard uncertainty", "degrees of freedom", "share"),
        rows=tuple(rows),
    )


def _zero(found: DisplacementBudget) -> str:
    if found.zero_between_m is None:
        return ""
    return (
        " The zero differed from run to run by a standard deviation of "
        f"{told(found.zero_between_m, 'm')}; that is not counted, set the axis to zero before use."
    )


def _row(found: DisplacementBudget, one: Contribution) -> tuple[str, ...]:
    return (
        one.name,
        one.kind,
        SHAPES[one.shape].format(tail=significant(one.tail, 2)),
        told(one.standard, "m"),
        _freedom(one.freedom),
        percent(found.budget.share(one)),
    )


def _freedom(freedom: float) -> str:
    return "unlimited" if math.isinf(freedom) or freedom > 1e4 else significant(freedom, 2)


def _unknown(found: DisplacementBudget) -> tuple[Part, ...]:
    if not found.unknown:
        return ()
    return (
        Prose(
            text="Nobody declared what follows, and no recording shows it, so the budget is a "
            "lower bound; write it into [uncertainty] of lab.toml:",
            tone="middling",
        ),
        Listing(items=tuple(f"{DECLARED[name]}: {name}" for name in found.unknown)),
    )


def _figure(found: DisplacementBudget, bound_m: float) -> Figure:
    held = found.budget
    # The last steps belong to single draws and would set the scale for all others.
    shown = held.probability <= 0.99
    single_m, largest_m = held.single_error[shown], held.largest_error[shown]
    share = held.probability[shown]
    x = axis_over("size of the error", [np.array([0.0, bound_m]), single_m, largest_m], "m")
    y = Axis(label="share of cases", scale=Scale(factor=0.01, unit="%"), low=0.0, high=103.0)
    canvas = Canvas(x=x, y=y, height=240)
    upright = np.array([0.0, 1.0])
    return Figure(
        title=f"Axis {found.axis}: how large an error is",
        numbers=f"95 % of single positions are within {told(held.propagated, 'm')}; of "
        f"{held.positions} positions the largest is within {told(held.largest[1], 'm')} in "
        f"97.5 % of cases; the certificate bounds every one by {told(bound_m, 'm')}.",
        look=LOOK,
        canvas=canvas,
        layers=(
            canvas.line("rising", "a single position", single_m, share),
            canvas.line("falling", f"the largest of {held.positions} positions", largest_m, share),
            canvas.line("limit", "certified bound", np.full(2, bound_m), upright),
        ),
    )
