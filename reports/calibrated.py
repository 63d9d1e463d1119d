"""The page of a calibration, among its other files."""

from dataclasses import replace

from piezoid.calibration.calibrate import Calibration
from piezoid.records.collection import Collection
from piezoid.records.lab import Lab
from piezoid_reports.render import render


def with_report(found: Calibration, held: Collection | None, lab: Lab | None) -> Calibration:
    """Return a calibration with report.html behind its files.

    held  the recordings, for the report's pictures; None where they are larger than memory
    """
    made = found.controllers
    page = render(
        found.model,
        () if held is None else held.recordings,
        () if held is None else held.sweeps,
        made.design,
        made.reason,
        responses=() if held is None else held.responses,
        diagnoses=found.diagnoses,
        undiagnosed=found.undiagnosed,
        verification=made.verification,
        unshipped=made.unshipped,
        files=found.files,
        lab=lab,
    )
    return replace(found, files={**found.files, "report.html": page.encode()})
