"""`piezoid plan`: what a diagnosis left open in, the drive of the next experiment out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from piezoid.diagnosis.experiment import Plan


def plan(
    stage: Annotated[Path, typer.Argument(help="Folder with model.json and diagnosis.json.")],
    files: Annotated[
        list[Path] | None,
        typer.Argument(help="The recordings that were diagnosed, to say what more is gained."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the plan; default: beside model.json.")
    ] = None,
    lab: Annotated[Path | None, typer.Option(help="lab.toml: range, slew and clock.")] = None,
    effect: Annotated[
        str | None, typer.Option(help="Ask about this one; default: what was left most open.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Converters' samples per second.", min=0.0)
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of what a drive leaves to chance.")] = 0,
    force: Annotated[bool, typer.Option(help="Replace what the folder holds.")] = False,
    quiet: Annotated[bool, typer.Option(help="Print nothing but errors.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print plan.json itself.")
    ] = False,
) -> None:
    """Plan the next experiment: write drive.csv and plan.json, say why and what to expect.

    [bold]Examples[/bold]

    piezoid plan stage42/ sweep.csv steps.csv --lab lab.toml --out next/

    piezoid plan stage42/ --effect creep --out next/ --json | jq .alternatives[].name

    Every drive stays inside the range that was used before and the limits of lab.toml. Exit
    status 3 means that no drive inside them answers.
    """
    from json import loads

    from piezoid_cli.output_folder import add_to_folder, check_free, write_folder
    from piezoid_cli.progress import shown
    from piezoid_cli.stage_files import lab_of

    if out is not None:
        check_free(out, force=force)
    with shown(quiet=quiet or json) as told:
        told("reading the stage")
        from piezoid.diagnosis.diagnosis import read_diagnosis
        from piezoid.diagnosis.experiment import plan as choose
        from piezoid.diagnosis.planning.plan_file import plan_files
        from piezoid.identification.store import read_model
        from piezoid.records.collection import collect

        model_json = (stage / "model.json").read_bytes()
        diagnosis_json = (stage / "diagnosis.json").read_bytes()
        model = read_model(model_json, str(stage / "model.json"))
        diagnosis = read_diagnosis(diagnosis_json, str(stage / "diagnosis.json"))
        declared = lab_of(stage, lab)
        held = collect(files, declared).recordings if files else ()
        told("playing the menu on the model")
        found = choose(
            model,
            diagnosis,
            lab=declared,
            recordings=held,
            effect=effect,
            clock_Hz=rate,
            seed=seed,
        )
        written = plan_files(
            found,
            model_digest=loads(model_json)["digest"],
            diagnosis_digest=loads(diagnosis_json)["digest"],
        )
        if out is None:
            add_to_folder(stage, written)
        else:
            write_folder(out, written, force=force)
    if json:
        typer.echo(written["plan.json"], nl=False)
    elif not quiet:
        _show(found, (out or stage) / "drive.csv")


def _show(found: "Plan", drive: Path) -> None:
    from rich.console import Console
    from rich.text import Text

    from piezoid.diagnosis.planning.plan_file import sentences

    console = Console()
    for sentence in sentences(found):
        console.print(Text(sentence))
    console.print(_table(found))
    console.print(Text(f"drive: {drive}"))


def _table(found: "Plan") -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"axis {found.axis}: {' against '.join(found.question.effects)}"))
    for heading in ("drive", "lasts", "separability", "error of the size"):
        table.add_column(heading, justify="left" if heading == "drive" else "right")
    for one in found.alternatives:
        if one.told is None:
            table.add_row(one.name, "", "", Text(one.refusal))
            continue
        alone = len(one.told.errors) == 1
        table.add_row(
            Text(one.name, style="bold" if one.name == found.drive.name else ""),
            f"{one.duration_s:.0f} s",
            "" if alone else f"{one.told.separability:.2g}",
            f"{100 * one.told.worst:.2g} %" if one.told.worst < 10.0 else "not shown",
        )
    return table
