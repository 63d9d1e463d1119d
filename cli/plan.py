"""`piezoid plan`: what a diagnosis left open in, the drive of the next experiment out."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from piezoid_cli.terminal import Force, Quiet, hand_over, plain, table

if TYPE_CHECKING:
    from rich.table import Table

    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.diagnosis.experiment import Plan
    from piezoid.identification.actuator_model import ActuatorModel


def plan(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and diagnosis.json.")],
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="The diagnosed recordings, to compare the new drive with."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the plan; default: beside model.json.")
    ] = None,
    lab: Annotated[Path | None, typer.Option(help="lab.toml: range, slew and clock.")] = None,
    axis: Annotated[
        str | None, typer.Option(help="Which axis; default: the first that was diagnosed.")
    ] = None,
    effect: Annotated[
        str | None, typer.Option(help="Effect to target; default: the least certain.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Converters' samples per second.", min=0.0)
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    force: Force = False,
    quiet: Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print plan.json itself.")
    ] = False,
) -> None:
    """Plan the next experiment: write drive.csv and plan.json.

    [bold]Examples[/bold]

    piezoid plan stage42/ sweep.csv steps.csv --lab lab.toml --out next/

    piezoid plan stage42/ --effect creep --out next/ --json | jq .alternatives[].name

    Every drive stays inside the recorded range and the limits of lab.toml. If no drive resolves
    the question, the best one is written with its expected gain and the limit that prevents more
    ("answers": false in plan.json); exit status 3 means that no drive shows the effect.
    """
    from piezoid.output_folder import add_to_folder, check_folder, write_folder
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import lab_of

    if out is None:
        check_folder(stage, force=force, names=("drive.csv", "plan.json"))
    else:
        read = [*(files or ()), stage / "model.json", *([] if lab is None else [lab])]
        check_folder(out, force=force, new=True, inputs=read)
    with shown(quiet=quiet or json) as told:
        told("reading the stage")
        from piezoid.diagnosis.experiment import plan as choose
        from piezoid.records.collection import collect

        known = _read(stage, axis)
        declared = lab_of(stage, lab)
        held = collect(files, declared).recordings if files else ()
        told("simulating candidate drives")
        found = choose(
            known.model,
            known.diagnosis,
            lab=declared,
            recordings=held,
            effect=effect,
            clock_Hz=rate,
            seed=seed,
        )
        written = known.files_of(found)
        if out is None:
            add_to_folder(stage, written, force=force)
        else:
            write_folder(out, written, force=force)
    if json:
        hand_over(written["plan.json"])
    elif not quiet:
        _show(found, (out or stage) / "drive.csv")


@dataclass(frozen=True, kw_only=True)
class _Known:
    """What a folder says of a stage, with the bytes that a plan names as its sources."""

    model: "ActuatorModel"
    diagnosis: "Diagnosis"
    model_json: bytes
    diagnosis_json: bytes

    def files_of(self, found: "Plan") -> dict[str, bytes]:
        """Return drive.csv and plan.json."""
        from json import loads

        from piezoid.diagnosis.planning.plan_file import plan_files

        return plan_files(
            found,
            model_digest=loads(self.model_json)["digest"],
            diagnosis_digest=loads(self.diagnosis_json)["digest"],
        )


def _read(stage: Path, axis: str | None) -> _Known:
    """Read model and diagnosis of a stage; the diagnosis of its first axis if none is named."""
    from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
    from piezoid.sealed_files import read_model
    from piezoid_cli.stage_files import content_of

    model_json = content_of(stage / "model.json")
    diagnosis_json = content_of(stage / "diagnosis.json")
    diagnoses = read_diagnoses(diagnosis_json, str(stage / "diagnosis.json"))
    found = next((one for one in diagnoses if axis in (None, one.axis)), None)
    if found is None:
        there = ", ".join(one.axis for one in diagnoses)
        raise typer.BadParameter(f"--axis {axis}: {stage / 'diagnosis.json'} holds {there}")
    return _Known(
        model=read_model(model_json, str(stage / "model.json")),
        diagnosis=found,
        model_json=model_json,
        diagnosis_json=diagnosis_json,
    )


def _show(found: "Plan", drive: Path) -> None:
    from rich.console import Console

    from piezoid.diagnosis.planning.plan_file import sentences

    console = Console()
    for sentence in sentences(found):
        console.print(plain(sentence))
    console.print(_table(found))
    console.print(plain(f"drive: {drive}"))


def _table(found: "Plan") -> "Table":
    """Return the drives that were simulated; separability only where two effects compete."""
    is_alone = found.question.kind != "separate"
    headings = ["drive", "duration", *(() if is_alone else ("separability",)), "error of the size"]
    rows: list[tuple[Any, ...]] = []
    for one in found.alternatives:
        if one.told is None:
            rows.append((one.name, *[""] * (len(headings) - 2), one.refusal))
            continue
        error = one.told.errors[0] if is_alone else one.told.worst
        rows.append(
            (
                plain(one.name, style="bold" if one.name == found.drive.name else ""),
                f"{one.duration_s:.0f} s",
                *(() if is_alone else (f"{one.told.separability:.2g}",)),
                f"{100 * error:.2g} %" if error < 10.0 else "not shown",
            )
        )
    title = f"axis {found.axis}: {' against '.join(found.question.effects)}"
    return table(title, headings, rows, left=1)
