"""`piezoid report`: the page of a stage, drawn again from the sealed files of its folder."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.terminal import Json, Quiet, hand_over_record, say

if TYPE_CHECKING:
    from piezoid.calibration.since import Since
    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.export.parameter_file import AxisParameters
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.records.collection import Collection
    from piezoid.verification.verification import Verification

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
    since: Annotated[
        Path | None,
        typer.Option(help="Folder of an earlier calibration: what changed since then."),
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Draw report.html again from the sealed files, for example after `piezoid verify`.

    The folder does not hold the recordings: name them to have loops and residuals drawn. A file
    that is not, byte for byte, one of those of the fit is refused.

    With --since, the page says as well which quantities moved beyond their intervals, which causes
    came or went, and whether the controller of then still holds on the stage as it is now. The
    exit status is 0 whatever the answer; --json has it as "controller_holds".

    [bold]Examples[/bold]

    piezoid report stage42/

    piezoid report stage42/ sweep.csv check.csv

    piezoid report today/ --since january/ --json | jq .since.controller_holds
    """
    from piezoid.sealed_files import read_model
    from piezoid_cli.output_folder import add_to_folder
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import content_of

    with shown(quiet=quiet or json) as told:
        told("reading the folder")
        held = {name: content_of(stage / name) for name in SEALED if (stage / name).exists()}
        content = content_of(stage / "model.json")
        model = read_model(content, str(stage / "model.json"))
        recorded = _recorded(model, files or (), stage, lab)
        compared = None if since is None else _since(model, held, since, told)
        told("drawing")
        page = _page(model, recorded, held, stage, lab, compared)
        add_to_folder(stage, {"report.html": page.encode()})
    if json:
        summary = None if compared is None else compared.summary()
        hand_over_record("reported", report=str(stage / "report.html"), since=summary)
    elif not quiet:
        if compared is not None:
            from piezoid_reports.sections.since import sentence

            say(sentence(compared))
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
    since: "Since | None",
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
        since=since,
    )


def _since(
    now: "ActuatorModel", held: dict[str, bytes], older: Path, told: "Callable[[str], None]"
) -> "Since":
    """Compare the stage with an earlier calibration, and run the controller of then on it."""
    from json import loads

    from piezoid.calibration.since import since
    from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
    from piezoid.sealed_files import read_model
    from piezoid_cli.stage_files import content_of

    told("reading the earlier calibration")
    then = content_of(older / "model.json")
    before: tuple[Diagnosis, ...] = ()
    if (place := older / "diagnosis.json").exists():
        before = read_diagnoses(content_of(place), str(place))
    after: tuple[Diagnosis, ...] = ()
    if "diagnosis.json" in held:
        after = read_diagnoses(held["diagnosis.json"], "diagnosis.json")
    told("running the controller of then")
    ran, reason = _controller_of_then(now, older)
    return since(
        read_model(then, str(older / "model.json")),
        now,
        then_digest=str(loads(then)["digest"]),
        now_digest=str(loads(held["model.json"])["digest"]),
        diagnoses_then=before,
        diagnoses_now=after,
        held=ran,
        unheld=reason,
    )


def _is_known(axis: "AxisParameters", now: "ActuatorModel") -> bool:
    """Return whether the stage of now has a plant for a controller."""
    if axis.method == "rst":
        return now.tunnelling is not None and now.tunnelling.loop_plant is not None
    return axis.axis in now.axes


def _controller_of_then(now: "ActuatorModel", older: Path) -> "tuple[Verification | None, str]":
    """Run what shipped then against the stage of now; say of which axes that cannot be done."""
    from dataclasses import replace

    from piezoid.errors import PiezoidError
    from piezoid.export.parameter_file import from_json
    from piezoid.verification.stage import verify_stage
    from piezoid_cli.side_by_side import usable_cores
    from piezoid_cli.stage_files import content_of, lab_of

    place = older / "params.json"
    if not place.exists():
        return None, f"there is no params.json in {older}."
    try:
        file = from_json(content_of(place), str(place))
        known = tuple(axis for axis in file.axes if _is_known(axis, now))
        left = ", ".join(axis.axis for axis in file.axes if axis not in known)
        reason = f"nothing of axis {left} was identified now." if left else ""
        if not known:
            return None, reason
        ran = replace(file, axes=known)
        return verify_stage(ran, now, lab=lab_of(older, None), threads=usable_cores()), reason
    except PiezoidError as error:
        return None, str(error)
