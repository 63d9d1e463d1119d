"""Pages of known axes with the recordings of their fit."""

from typing import Any

from piezoid.identification.model import AxisModel
from piezoid_reports.page import Page
from piezoid_reports.render import render
from tests.reports.known_stage import recording, stage_model


def page_of(*axes: AxisModel, **parts: Any) -> str:
    """Return the page of a stage of these axes; ``parts`` are the other fields of a page."""
    names = {start.recording: axis.axis for axis in axes for start in axis.starts}
    recordings = [recording(name, axis) for name, axis in names.items()]
    return render(Page(model=stage_model(*axes), **{"recordings": recordings, **parts}))
