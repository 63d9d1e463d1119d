"""Why a loop is slow: nobody has seen the mode that a faster one might excite."""

from piezoid.design.design import AxisDesign
from piezoid.design.lateral_task import BEYOND, unseen
from piezoid_reports.page import Page
from piezoid_reports.quantities import told


def held_back(page: Page, axis: AxisDesign) -> tuple[str, str] | None:
    """Return the largest bandwidth that was tried, and why no larger; None where nothing held it.

    A specification of the user's own has no such limit.
    """
    known = page.model.axes.get(axis.axis)
    guarded = any(limit.name == BEYOND for limit in axis.specification.templates)
    if known is None or not guarded:
        return None
    beyond = unseen(known)
    return None if beyond.fastest_Hz is None else (told(beyond.fastest_Hz, "Hz"), beyond.known)
