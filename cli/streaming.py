"""`piezoid fit --stream`: the way of a stage whose recordings do not fit into memory."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid_cli.calibration import Calibration, Told

UNDIAGNOSED = (
    "not diagnosed: a fit in blocks does not look for causes; fit a part of the recording that "
    "fits into memory (start_s and stop_s in lab.toml) to have it diagnosed"
)


def calibrate_streamed(
    files: Sequence[Path], lab: Path | None, folder: Path, told: "Told"
) -> "Calibration":
    """Fit in blocks, design, export, verify and report one stage.

    folder  where the scratch files go, 16 bytes a sample; they have no names and leave nothing

    The report has no loops and no residuals: they would take the recordings at once.
    """
    from piezoid.identification.store import write_model
    from piezoid.identification.streamed.fit_streamed import fit_streamed
    from piezoid.records.lab import read_lab
    from piezoid.records.streams.spool import spooled
    from piezoid_cli.calibration import Calibration
    from piezoid_cli.controllers import controllers_of, files_of
    from piezoid_reports.render import render

    declared = None if lab is None else read_lab(lab)
    folder.mkdir(parents=True, exist_ok=True)
    with spooled(files, declared, folder=folder, progress=told) as spool:
        model = fit_streamed(spool, lab=declared, progress=told)
    content = {"model.json": write_model(model)}
    if lab is not None:
        content["lab.toml"] = lab.read_bytes()
    made = controllers_of(model, content["model.json"], declared, told)
    content |= files_of(made)
    told("writing the report")
    page = render(
        model,
        (),
        (),
        made.design,
        made.reason,
        undiagnosed=(UNDIAGNOSED,),
        verification=made.verification,
        unshipped=made.unshipped,
        files=content,
        lab=declared,
    )
    return Calibration(
        model=model,
        diagnoses=(),
        undiagnosed=(UNDIAGNOSED,),
        controllers=made,
        stumbled=made.stumbled,
        files={**content, "report.html": page.encode()},
    )
