"""The certificate: a bound on the model's error, with the conditions it holds under."""

from piezoid.identification.model import AxisModel
from piezoid_reports.page import Page, Part, Prose, Section, Table
from piezoid_reports.quantities import percent, told


def render(page: Page) -> Section:
    """Return a sentence and a table for each axis."""
    return Section(
        anchor="certificate",
        title="Certificate",
        lead="How wrong the model can be for any drive in its range. The three terms add up in "
        "the worst case, so the bound is far above the usual error; a design may lean on it.",
        parts=tuple(part for axis in page.axes for part in _parts(axis)),
    )


def _parts(axis: AxisModel) -> tuple[Part, ...]:
    if not axis.verdict.applies:
        text = (
            f"Axis {axis.axis}: no certificate. A bound derived from a model that does not apply "
            "bounds nothing."
        )
        return (Prose(text=text, tone="bad"),)
    return Prose(text=_sentence(axis)), _table(axis)


def _sentence(axis: AxisModel) -> str:
    found = axis.certificate
    if not axis.quality.is_tested:
        return (
            f"Axis {axis.axis}: no certificate. Nothing was left out to test the model on, and "
            "what it leaves of its own data bounds no error on others; the terms below are those "
            "of the fit alone."
        )
    if found.bound_m > axis.quality.range_m:
        return (
            f"Axis {axis.axis}: no useful bound. The terms below add up to more than the whole "
            f"range of the displacement, {told(axis.quality.range_m, 'm')}: the recordings leave "
            "too many models open, or one they leave out is too far off."
        )
    middle_V = axis.hysteresis.voltage_offset_V
    return (
        f"Axis {axis.axis}: with 95 % confidence the model is within {told(found.bound_m, 'm')} "
        f"({percent(found.bound_m / axis.quality.range_m)} of the range) of a stage of this "
        f"class, for every drive between {told(middle_V - found.reach_V, 'V')} and "
        f"{told(middle_V + found.reach_V, 'V')} that changes no faster than "
        f"{told(found.slew_V_per_s, 'V/s')}, at the temperature and load of the recordings."
        f"{_one_speed(axis)}"
    )


def _one_speed(axis: AxisModel) -> str:
    if not axis.quality.lag_is_open:
        return ""
    return (
        " It holds at the speed of the recordings alone: no other was recorded, and where the "
        "loop is a lag its width goes with the speed."
    )


def _table(axis: AxisModel) -> Table:
    found = axis.certificate
    return Table(
        caption=f"Axis {axis.axis}: what the bound is made of.",
        columns=("term", "at most", "from"),
        rows=(
            (
                "plays",
                told(found.plays_m, "m"),
                "95 % quantile over models within the uncertainty",
            ),
            ("dead zones", told(found.dead_zones_m, "m"), "the same"),
            (
                "remainder",
                told(found.remainder_m, "m"),
                "99.9 % quantile of the held-out residual",
            ),
            ("sum", told(found.bound_m, "m"), "bound"),
            (
                "largest found",
                told(found.found_m, "m"),
                "search over adversarial drives, beside plays and dead zones together",
            ),
        ),
    )
