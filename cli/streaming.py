"""`piezoid fit --stream`: the way of a stage whose recordings do not fit into memory."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.calibration.calibrate import Calibration, Told

UNDIAGNOSED = (
    "not diagnosed: a fit in blocks does not look for causes; fit a part of the recording that "
    "fits into memory (start_s and stop_s in lab.toml) to have it diagnosed"
)


def calibrate_streamed(
    files: Sequence[Path], lab: Path | None, folder: Path, told: "Told", processes: int = 1
) -> "Calibration":
    """Fit in blocks, design, export, verify and report one stage.

    folder     where the scratch files go, 16 bytes a sample; they have no names and leave nothing
    processes  at most so many blocks are read and followed side by side, in threads of this one

    The report has no loops and no residuals: they would take the recordings at once.
    """
    from piezoid.calibration.calibrate import FittedStage, finished
    from piezoid.identification.streamed.fit_streamed import fit_streamed
    from piezoid.records.lab import read_lab
    from piezoid.records.streams.spool import spooled
    from piezoid_reports.calibrated import with_report

    declared = None if lab is None else read_lab(lab)
    folder.mkdir(parents=True, exist_ok=True)
    with spooled(files, declared, folder=folder, workers=processes, progress=told) as spool:
        model = fit_streamed(spool, lab=declared, workers=processes, progress=told)
    done = finished(FittedStage(model=model, undiagnosed=(UNDIAGNOSED,)), declared, told)
    told("writing the report")
    return with_report(done, None, declared)
