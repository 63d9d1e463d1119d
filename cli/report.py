"""`piezoid report`: write the report of a stage again from its sealed files."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.options import ForceEdited, Json, Quiet, StageLab
from piezoid_cli.terminal import print_record, say, show_progress

if TYPE_CHECKING:
    from piezoid.records.collection import Collection
    from piezoid_cli.stage_files import StageFolder

SEALED = ("model.json", "diagnosis.json", "design.json", "params.json", "verification.json")

UNDESIGNED = "the folder has no design.json; run `piezoid design`."


def report(
    stage: Annotated[Path, typer.Argument(help="Folder that `piezoid fit` wrote.")],
    files: Annotated[
        list[Path] | None, typer.Argument(help="The recordings of the fit, for the figures.")
    ] = None,
    lab: StageLab = None,
    force: ForceEdited = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write report.html again from the JSON files of a stage, for example after `piezoid verify`.

    Name the recordings of the fit to plot loops and residuals; other files are rejected.

    [bold]Examples[/bold]

    piezoid report stage42/

    piezoid report stage42/ sweep.csv check.csv
    """
    from piezoid.errors import RecordingError
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.records.collection import collect
    from piezoid_cli.stage_files import StageFolder, content_of, out_of_date

    with show_progress(quiet=quiet or json) as progress:
        progress("reading the folder")
        check_folder(stage, force=force, names=("report.html",))
        folder = StageFolder(stage, lab)
        contents = {n: content_of(stage / n) for n in SEALED if (stage / n).exists()}
        stale = out_of_date(folder, contents)
        model = folder.model
        recorded = collect(files or (), folder.lab)
        for name, digest in ((file.name, file.digest) for file in recorded.files):
            if model.sources.get(name) != digest:
                difference = "is not one of the recordings of this model"
                if name in model.sources:
                    difference = "has other contents than the recording of that name in this model"
                raise RecordingError(
                    f"{name} {difference} ({', '.join(model.sources) or 'none'})",
                    needed="the recordings of the fit, unchanged",
                    remedy="Name those recordings, or fit again with this one.",
                )
        progress("writing the report")
        current = {name: text for name, text in contents.items() if name not in stale}
        page = _page(folder, recorded, current)
        add_to_folder(stage, {"report.html": page.encode()}, force=force)
    if json:
        print_record("reported", report=str(stage / "report.html"), out_of_date=stale)
    elif not quiet:
        for name, reason in stale.items():
            say(f"left out because it is out of date: {name} ({reason})")
        if model.sources and not files:
            say("without loops and residuals: name the recordings of the fit to plot them")
        elif missing := model.missing_recordings(recorded.files):
            say(f"{missing} The figures and tables of the report do not contain them.")
        say(f"report: {stage / 'report.html'}")


def _page(folder: "StageFolder", recorded: "Collection", files: Mapping[str, bytes]) -> str:
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
    from piezoid.verification.verification import verification_from_json
    from piezoid_reports.page import Page
    from piezoid_reports.render import render

    design = folder.design if "design.json" in files else None
    unshipped: Mapping[str, str] = {} if design is None else design.refused
    if "params.json" in files:
        unshipped = folder.parameters.unshipped
    diagnoses: tuple[Diagnosis, ...] = ()
    verification = None
    if (name := "diagnosis.json") in files:
        diagnoses = read_diagnoses(files[name], str(folder.folder / name))
    if (name := "verification.json") in files:
        verification = verification_from_json(files[name], str(folder.folder / name))
    page = Page(
        model=folder.model,
        recordings=recorded.recordings,
        sweeps=recorded.sweeps,
        responses=recorded.responses,
        design=design,
        undesigned="" if design else UNDESIGNED,
        diagnoses=diagnoses,
        verification=verification,
        unshipped=unshipped,
        files=files,
        lab=folder.lab,
    )
    return render(page)
