"""What the data cannot tell, what the fit remarks of itself, and the next experiment."""

from piezoid.identification.model import AxisModel
from piezoid_reports.page import Listing, Page, Part, Prose, Section, Table, axis_heading
from piezoid_reports.quantities import told
from piezoid_reports.weaknesses import weaknesses_of


def render(page: Page) -> Section:
    """Return remarks, untested conditions and experiments for every axis."""
    parts: list[Part] = []
    for axis in page.axes:
        parts.append(axis_heading(axis))
        parts += [_experiments(page, axis), *_remarks(axis)]
        parts += [Prose(text="Never tested by these recordings:"), _untested(axis)]
    return Section(
        anchor="limits",
        title="What this data cannot tell, and what to do next",
        lead="The gravest weakness first. A result must say where it ends.",
        parts=tuple(parts),
    )


def _experiments(page: Page, axis: AxisModel) -> Part:
    found = weaknesses_of(axis, page.diagnosis_of(axis))
    if not found:
        return Prose(text="No weakness was found in this fit.", tone="good")
    return Table(
        caption=f"Axis {axis.axis}: weaknesses and the next experiment.",
        columns=("why", "what to do"),
        rows=tuple((weakness.why, weakness.remedy) for weakness in found),
    )


def _remarks(axis: AxisModel) -> tuple[Part, ...]:
    if not axis.verdict.remarks:
        return ()
    return Prose(text="The fit remarks of itself:"), Listing(items=axis.verdict.remarks)


def _untested(axis: AxisModel) -> Listing:
    low_V, high_V = axis.voltage_V
    return Listing(
        items=(
            f"Drives below {told(low_V, 'V')} or above {told(high_V, 'V')} were never applied: "
            "there the model extrapolates.",
            f"Drives that change faster than {told(axis.certificate.slew_V_per_s, 'V/s')} were "
            "never applied: the model has no resonance.",
            "Temperature, load and age were those of the recordings; nothing here says how the "
            "model changes with them.",
        )
    )
