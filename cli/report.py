"""`piezoid report`: the page of a stage, drawn again from the sealed files of its folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.terminal import Force, Json, Quiet, hand_over_record, say

if TYPE_CHECKING:
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.records.collection import Collection

SEALED = ("model.json", "diagnosis.json", "design.json", "params.json", "verification.json")

UNDESIGNED = "there is no design.json in the folder; `piezoid design` makes one, or says why not."


def report(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and what followed it.")],
    files: Annotated[
        list[Path] | None, typer.Argument(help="The recordings of the fit, to draw its figures.")
    ] = None,
    lab: Annotated[
        Path | None, typer.Option(help="lab.toml; default: the one in the folder.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Draw report.html again from the sealed files, for example after `piezoid verify`.

    Name the recordings of the fit to draw loops and residuals; other files are refused.

    [bold]Examples[/bold]

    piezoid report stage42/

    piezoid report stage42/ sweep.csv check.csv
    """
    from piezoid.output_folder import add_to_folder, check_folder
    from piezoid.sealed_files import read_model
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import content_of, lab_of, out_of_date

    with shown(quiet=quiet or json) as told:
        told("reading the folder")
        check_folder(stage, force=force, names=("report.html",))
        held = {name: content_of(stage / name) for name in SEALED if (stage / name).exists()}
        stale = out_of_date(stage, held, lab_of(stage, lab))
        content = content_of(stage / "model.json")
        model = read_model(content, str(stage / "model.json"))
        recorded = _recorded(model, files or (), stage, lab)
        told("drawing")
        current = {name: content for name, content in held.items() if name not in stale}
        page = _page(model, recorded, current, stage, lab)
        add_to_folder(stage, {"report.html": page.encode()}, force=force)
    if json:
        hand_over_record("reported", report=str(stage / "report.html"), out_of_date=stale)
    elif not quiet:
        for name, why in stale.items():
            say(f"left out, for it is out of date: {name} ({why})")
        if model.sources and not files:
            say("without its recordings: no loops, no residuals, no score")
        say(f"report: {stage / 'report.html'}")


def _recorded(
    model: "ActuatorModel", files: Sequence[Path], stage: Path, lab: Path | None
) -> "Collection":
    """Read the recordings of the fit, and refuse any other file."""
    from piezoid.errors import RecordingError
    from piezoid.records.collection import collect
    from piezoid_cli.stage_files import lab_of

    held = collect(files, lab_of(stage, lab))
    read = [(one.name, one.digest) for one in held.recordings]
    read += [(one.name, one.digest) for one in held.sweeps]
    read += [(one.name, one.digest) for one in held.responses]
    for name, digest in read:
        if model.sources.get(name) != digest:
            known = ", ".join(model.sources) or "none"
            raise RecordingError(
                f"{name} is not one of the recordings of this model ({known})",
                needed="the very files that were fitted, byte for byte",
                remedy="Name those, or fit again with this one.",
            )
    return held


def _page(
    model: "ActuatorModel",
    recorded: "Collection",
    held: dict[str, bytes],
    stage: Path,
    lab: Path | None,
) -> str:
    from piezoid.design.design import design_from_json
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
    from piezoid.export.parameter_file import from_json
    from piezoid.verification.verification import verification_from_json
    from piezoid_cli.stage_files import lab_of, same_model
    from piezoid_reports.render import render

    def place(name: str) -> str:
        return str(stage / name)

    design = verification = None
    diagnoses: tuple[Diagnosis, ...] = ()
    if "design.json" in held:
        design = design_from_json(held["design.json"], place("design.json"))
        same_model(held["model.json"], design.model_digest, "design.json", "piezoid design")
    if "diagnosis.json" in held:
        diagnoses = read_diagnoses(held["diagnosis.json"], place("diagnosis.json"))
    unshipped: Mapping[str, str] = {} if design is None else design.refused
    if "params.json" in held:
        unshipped = from_json(held["params.json"], place("params.json")).unshipped
    if "verification.json" in held:
        verification = verification_from_json(
            held["verification.json"], place("verification.json")
        )
    return render(
        model,
        recorded.recordings,
        recorded.sweeps,
        design,
        "" if design else UNDESIGNED,
        responses=recorded.responses,
        diagnoses=diagnoses,
        verification=verification,
        unshipped=unshipped,
        files=held,
        lab=lab_of(stage, lab),
    )
