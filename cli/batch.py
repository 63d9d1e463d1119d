"""`piezoid batch`: a folder of stages in, every stage's folder and one summary page out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from piezoid_cli.options import Quiet
from piezoid_cli.progress import shown
from piezoid_cli.terminal import doing, hand_over, one_line, plain

if TYPE_CHECKING:
    from piezoid_cli.batch_folder import Plan
    from piezoid_reports.fleet.records import Fleet, FleetStage


def batch(
    folder: Annotated[Path, typer.Argument(help="One folder below it for each stage.")],
    out: Annotated[Path, typer.Option(help="Folder for the results; resumed if it is there.")],
    scheduler: Annotated[
        str, typer.Option(help="Work there instead of here.", metavar="tcp://HOST:PORT")
    ] = "",
    workers: Annotated[
        int | None, typer.Option(help="Processes here; one for each core if not given.", min=1)
    ] = None,
    retries: Annotated[
        int, typer.Option(help="How often a stage whose work broke off is tried again.", min=0)
    ] = 2,
    force: Annotated[
        bool, typer.Option("--force", help="Do stages again whose files have changed.")
    ] = False,
    quiet: Quiet = False,
    json: Annotated[
        bool, typer.Option("--json", help="For scripts: print batch.json itself.")
    ] = False,
) -> None:
    """Calibrate many stages at once: every folder that holds recordings and a lab.toml is one.

    Writes stages/NAME/ as `piezoid fit` does, summary.html (spread of the parameters, outliers,
    drift over serial numbers, failures with reasons), parameters.parquet and batch.json.

    A worker that dies loses nothing. Interrupted or started again, it goes on where it was:
    stages are finished while their files and the version of piezoid are the same.

    Exit status 1 means that at least one stage did not pass; the summary says which and why.

    [bold]Examples[/bold]

    piezoid batch night/ --out results/

    piezoid batch night/ --out results/ --scheduler tcp://10.0.0.5:8786 --json
    """
    from piezoid_cli.batch_folder import keep_summary, plan_batch

    plan = plan_batch(folder, out, force=force)
    with _bar(plan, quiet=quiet or json) as ended:
        stages = _all(plan, out, scheduler, workers, retries, ended)
    fleet = _fleet(folder, stages)
    keep_summary(out, _summary(fleet))
    if json:
        hand_over(fleet.to_json())
    elif not quiet:
        _show(fleet, plan, out)
    if not fleet.passed:
        raise typer.Exit(1)


def _all(
    plan: "Plan",
    out: Path,
    scheduler: str,
    processes: int | None,
    retries: int,
    ended: "Callable[[FleetStage], None]",
) -> "list[FleetStage]":
    """Return every stage; each is written as soon as it is done."""
    from piezoid_cli.batch_cluster import results
    from piezoid_cli.batch_cluster import workers as cluster
    from piezoid_cli.batch_folder import keep

    stages = list(plan.finished)
    if not plan.waiting:
        return stages
    with cluster(scheduler, processes) as client:
        for done in results(client, plan.waiting, retries):
            keep(out, done)
            stages.append(done.stage)
            ended(done.stage)
    return stages


def _fleet(folder: Path, stages: "list[FleetStage]") -> "Fleet":
    from piezoid_reports.fleet.records import Fleet

    ordered = sorted(stages, key=lambda stage: stage.name)
    return Fleet(name=folder.resolve().name, stages=tuple(ordered))


def _summary(fleet: "Fleet") -> dict[str, bytes]:
    from piezoid_cli.batch_folder import RECORD
    from piezoid_cli.batch_table import parquet_of
    from piezoid_reports.fleet.render import render_fleet

    return {
        "summary.html": render_fleet(fleet).encode(),
        "parameters.parquet": parquet_of(fleet),
        RECORD: fleet.to_json(),
    }


@contextmanager
def _bar(plan: "Plan", *, quiet: bool) -> "Iterator[Callable[[FleetStage], None]]":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TimeElapsedColumn,
    )
    from rich.progress import TimeRemainingColumn as Remaining

    console = Console(stderr=True, quiet=quiet)
    columns = (
        doing(), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        Remaining(),
    )  # fmt: skip
    whole = len(plan.waiting) + len(plan.finished)
    if quiet or not console.is_terminal:
        with shown(quiet=quiet) as told:
            numbers = count(len(plan.finished) + 1)
            yield lambda stage: told(f"{next(numbers)} of {whole} stages done: {stage.name}")
        return
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("stages", total=whole, completed=len(plan.finished))
        yield lambda stage: progress.update(task, advance=1, description=one_line(stage.name))


def _show(fleet: "Fleet", plan: "Plan", out: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from piezoid_reports.fleet.records import STATES

    console = Console()
    table = Table(title=plain(f"batch {fleet.name}: {len(fleet.stages)} stages"))
    for heading in ("stages", "state", "meaning"):
        table.add_column(heading)
    for state, meaning in STATES.items():
        held = fleet.of_state(state)
        if held:
            table.add_row(str(len(held)), state, meaning)
    console.print(table)
    if plan.finished:
        console.print(f"{len(plan.finished)} were finished before and were not done again")
    for stage in fleet.stages:
        if stage.reason:
            console.print(plain(f"{stage.name}: {stage.state}: {stage.reason}", style="dim"))
    console.print(plain(f"summary: {out / 'summary.html'}, {out / 'parameters.parquet'}"))
