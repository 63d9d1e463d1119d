"""What the data cannot tell, what the fit remarks of itself, and the next experiment."""

from piezoid.identification.model import AxisModel
from piezoid_reports.page import Listing, Page, Part, Prose, Section, Table, axis_heading
from piezoid_reports.quantities import told
from piezoid_reports.weaknesses import weaknesses_of
from piezoid_reports.what_is_left import named


def render(page: Page) -> Section:
    """Return remarks, untested conditions and experiments for every axis."""
    parts: list[Part] = []
    for axis in page.axes:
        parts.append(axis_heading(axis))
        parts += [_experiments(page, axis), *_remarks(page, axis)]
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
        wordy=(0, 1),
        rows=tuple((weakness.why, weakness.remedy) for weakness in found),
    )


def _remarks(page: Page, axis: AxisModel) -> tuple[Part, ...]:
    if not axis.verdict.remarks:
        return ()
    found = page.diagnosis_of(axis)
    before = f", before {named(found)} was taken out" if found and found.findings else ""
    return Prose(text=f"The fit remarks of itself{before}:"), Listing(items=axis.verdict.remarks)


def _untested(axis: AxisModel) -> Listing:
    low_V, high_V = axis.voltage_V
    return Listing(
        items=(
            f"Drives below {told(low_V, 'V')} or above {told(high_V, 'V')} were never applied: "
            "there the model extrapolates.",
            f"Drives that change faster than {told(axis.certificate.slew_V_per_s, 'V/s')} were "
            "never applied: what a resonance or the amplifier does there is not known.",
            "Temperature, load and age were those of the recordings; nothing here says how the "
            "model changes with them.",
        )
    )
