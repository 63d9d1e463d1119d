"""`piezoid diagnose`: recordings in, what the simulation gets wrong and why out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from piezoid.diagnosis.diagnosis import Diagnosis


def diagnose(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one stage, in order.")],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    lab: Annotated[Path | None, typer.Option(help="lab.toml: rig, columns and units.")] = None,
    axis: Annotated[str | None, typer.Option(help="Which axis; default: the first.")] = None,
    force: Annotated[bool, typer.Option(help="Replace what the folder holds.")] = False,
    quiet: Annotated[bool, typer.Option(help="Print nothing but errors.")] = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print diagnosis.json itself.")
    ] = False,
) -> None:
    """Name what a simulation with hysteresis alone gets wrong: write diagnosis.json.

    [bold]Examples[/bold]

    piezoid diagnose sweep.csv staircase.csv --lab lab.toml --out diag42/

    piezoid diagnose *.csv --lab lab.toml --axis y --out diag42y/ --json | jq .findings[].effect
    """
    from piezoid_cli.output_folder import check_free, write_folder
    from piezoid_cli.progress import shown

    check_free(out, force=force)
    with shown(quiet=quiet or json) as told:
        told("reading recordings")
        from piezoid.diagnosis.diagnose import diagnose as find
        from piezoid.diagnosis.diagnosis import write_diagnosis
        from piezoid.records.collection import collect
        from piezoid.records.lab import read_lab

        declared = None if lab is None else read_lab(lab)
        found = find(collect(files, declared).recordings, axis=axis, lab=declared, progress=told)
        content = write_diagnosis(found)
        write_folder(out, {"diagnosis.json": content})
    if json:
        typer.echo(content, nl=False)
    elif not quiet:
        _show(found, out)


def _show(found: "Diagnosis", out: Path) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console()
    console.print(_table(found))
    console.print(
        Text(
            f"of the explainable error {100 * found.explained_fraction:.0f} % is explained; "
            f"{1e9 * found.final.rms_m:.3g} nm are left on rows left out, "
            f"the sensor's noise is {1e9 * found.noise_floor_rms_m:.3g} nm"
        )
    )
    console.print(Text(f"all that was tested: {out / 'diagnosis.json'}"))


def _table(found: "Diagnosis") -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"axis {found.axis}: {len(found.findings)} found"))
    for heading in ("effect", "gain", "size", "95 %", "not separable from"):
        table.add_column(heading)
    for finding in found.findings:
        low, high = finding.size.ci95
        table.add_row(
            Text(finding.effect),
            f"{100 * finding.held_out_gain:.1f} %",
            Text(f"{finding.size.value:.4g} {finding.size.unit}"),
            f"{low:.4g} .. {high:.4g}",
            Text(", ".join(finding.not_separable_from)),
        )
    return table
