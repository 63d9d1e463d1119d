"""`piezoid batch`: a folder of stages in, every stage's folder and one summary page out."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import typer

from piezoid_cli.progress import shown
from piezoid_cli.terminal import JsonFile, Quiet, doing, hand_over, one_line, plain, table

if TYPE_CHECKING:
    from distributed import Client

    from piezoid_cli.stage_task import Outcome, StageTask
    from piezoid_reports.fleet.records import Fleet, FleetStage, StagesOnDisk

TOGETHER = 5000  # stages that are rows in memory at one time
MOST_REASONS = 200  # stages that did not pass and are named in the terminal


def batch(
    folder: Annotated[Path, typer.Argument(help="One folder below it for each stage.")],
    out: Annotated[
        str,
        typer.Option(
            help="Folder for the results, or a URL that fsspec can write to; resumed if it is "
            "there.",
            metavar="FOLDER|URL",
        ),
    ],
    scheduler: Annotated[
        str, typer.Option(help="Use this dask scheduler.", metavar="tcp://HOST:PORT")
    ] = "",
    workers: Annotated[
        int | None, typer.Option(help="Number of worker processes; default: one per core.", min=1)
    ] = None,
    retries: Annotated[int, typer.Option(help="Retries per stage.", min=0)] = 2,
    force: Annotated[
        bool, typer.Option("--force", help="Do stages again whose files have changed.")
    ] = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Calibrate many stages: one for each folder with recordings and a lab.toml.

    Writes stages/NAME/ as `piezoid fit` does, summary.html (spread of the parameters, outliers,
    drift over serial numbers, failures with reasons), parameters.parquet and batch.json.

    Workers write the results, so they must see --out and FOLDER under the same names.
    An --out such as s3://night/results needs the package of that store, here s3fs.

    A killed worker costs time and no result. A second start skips stages that are finished, as
    long as their files and the version of piezoid are the same.

    Exit status 1 means that at least one stage did not pass; the summary says which and why.

    [bold]Examples[/bold]

    piezoid batch night/ --out results/

    piezoid batch night/ --out results/ --scheduler tcp://10.0.0.5:8786 --json

    piezoid batch night/ --out s3://night/results --scheduler tcp://10.0.0.5:8786
    """
    from piezoid_cli.batch_cluster import stages_of
    from piezoid_cli.batch_cluster import workers as cluster
    from piezoid_cli.results_place import results_place
    from piezoid_reports.fleet.records import Fleet, StagesOnDisk

    tasks = stages_of(folder, out)
    results_place(out, force=force).check()
    with StagesOnDisk() as stages:
        with (
            cluster(scheduler, workers) as client,
            _bar(len(tasks), quiet=quiet or json) as (before, ended),
        ):
            done = done_by(client, tasks, stages, retries, force=force, before=before, ended=ended)
        fleet = Fleet(name=folder.resolve().name, stages=stages)
        write_summary(out, fleet, printed=json, force=force)
        if not (quiet or json):
            _show(fleet, done, out)
        if not fleet.passed:
            raise typer.Exit(1)


def done_by(
    client: "Client",
    tasks: "Sequence[StageTask]",
    stages: "StagesOnDisk",
    retries: int = 2,
    *,
    force: bool = False,
    before: Callable[[int], None] = lambda _: None,
    ended: Callable[[str], None] = lambda _: None,
    work: "Callable[[Sequence[StageTask]], Sequence[Outcome]] | None" = None,
) -> int:
    """Let workers do what is to be done, each stage written by the worker that did it.

    stages  where the record of every stage goes, those that are finished among them
    before  told how many are finished already
    ended   told the name of every other one
    work    what workers do of some tasks; ``work_off`` if not given

    Returns how many were finished before.
    """
    from dataclasses import replace
    from functools import partial

    from piezoid.errors import OutputFolderError
    from piezoid_cli.batch_cluster import answers, waiting_of
    from piezoid_cli.results_place import RECORD, results_place
    from piezoid_cli.stage_task import Known, Outcome, StageTask, broken, known_of, work_off
    from piezoid_reports.fleet.records import CRASHED

    place, tasks = results_place(tasks[0].results), [replace(t, force=force) for t in tasks]
    unknown = lambda task, _: Known(task.name, None, False)  # noqa: E731
    waiting = waiting_of(
        tasks,
        partial(answers, client, known_of, retries=retries, broken_off=unknown),
        force=force,
        finished=stages.add,
    )
    finished = len(stages)
    before(finished)
    place.begin()

    def broken_off(task: StageTask, reason: str) -> Outcome:
        record = broken(task, CRASHED, reason)
        with suppress(OutputFolderError):  # somebody put a file there meanwhile
            place.write(task.name, {RECORD: record.to_json()})
        return Outcome(task.name, record.packed())

    for name, packed in answers(client, work or work_off, waiting, retries, broken_off):
        stages.add(name, packed)
        ended(name)
    place.tidy(task.name for task in tasks)
    return finished


def write_summary(out: str, fleet: "Fleet", *, printed: bool = False, force: bool = False) -> None:
    """Write what is said of all stages, the batch's own record last.

    printed  whether that record is printed as well
    force    replace a summary although it was edited
    """
    from piezoid_cli.results_place import SUMMARY, results_place
    from piezoid_reports.fleet.chapters import render_fleet

    def write_record(stream: BinaryIO) -> None:
        fleet.write_json(stream)
        if printed:
            stream.seek(0)
            for line in stream:
                hand_over(line)

    place = results_place(out, force=force)
    page, table, record = SUMMARY
    place.put(page, lambda to: to.write(render_fleet(fleet).encode()))
    place.put(table, lambda to: write_table(fleet, to))
    place.put(record, write_record)


@contextmanager
def _bar(
    total: int, *, quiet: bool
) -> Iterator[tuple[Callable[[int], None], Callable[[str], None]]]:
    """Give what is told how many stages are finished already, and what is told of each other."""
    from rich import progress as bar
    from rich.console import Console

    console = Console(stderr=True, quiet=quiet)
    columns = (
        *(doing(), bar.BarColumn(), bar.MofNCompleteColumn()),
        *(bar.TimeElapsedColumn(), bar.TimeRemainingColumn()),
    )
    n_done = 0

    def set_finished(finished: int) -> None:
        nonlocal n_done
        n_done = finished
        progress.update(task, completed=finished)

    def line(name: str) -> None:
        nonlocal n_done
        n_done += 1
        report(f"{n_done} of {total} stages done: {name}")

    is_visible = console.is_terminal and not quiet
    with bar.Progress(
        *columns, console=console, transient=True, disable=not is_visible
    ) as progress:
        task = progress.add_task("stages", total=total)
        if is_visible:
            advance = partial(progress.update, task, advance=1)
            yield set_finished, lambda name: advance(description=one_line(name))
            return
        with shown(quiet=quiet) as report:
            yield set_finished, line


def _show(fleet: "Fleet", n_finished: int, out: str) -> None:
    from itertools import islice

    from rich.console import Console

    from piezoid_reports.fleet.records import PASSED, STATES

    console, count = Console(), fleet.counts
    rows = [
        (str(count[state]), state, meaning)
        for state, meaning in STATES.items()
        if count.get(state)
    ]
    title = f"batch {fleet.name}: {len(fleet.stages)} stages"
    console.print(table(title, ("stages", "state", "meaning"), rows, left=3))
    if n_finished:
        console.print(f"{n_finished} were finished before and were not done again")
    if n_uncontrolled := fleet.without_controller:
        console.print(
            f"{n_uncontrolled} passed without a controller: their reports say what is missing"
        )
    for stage in islice((stage for stage in fleet.stages if stage.reason), MOST_REASONS):
        console.print(plain(f"{stage.name}: {stage.state}: {stage.reason}", style="dim"))
    beyond = len(fleet.stages) - fleet.counts.get(PASSED, 0) - MOST_REASONS
    if beyond > 0:
        console.print(f"and {beyond} more, with their reasons in parameters.parquet")
    console.print(plain(f"summary: {_in(out, 'summary.html')}, {_in(out, 'parameters.parquet')}"))


def _in(out: str, name: str) -> str:
    return f"{out.rstrip('/')}/{name}" if "://" in out else str(Path(out) / name)


def write_table(fleet: "Fleet", stream: BinaryIO) -> None:
    """Write the table; a stage that was refused is a row without an axis."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from piezoid_reports.fleet.quantities import QUANTITIES

    named = _parameter_names(fleet)
    columns = [
        *(pa.field(name, pa.string()) for name in ("stage", "state", "reason", "axis")),
        pa.field("serial", pa.int64()),
        pa.field("applies", pa.bool_()),
        *(pa.field(quantity.name, pa.float64()) for quantity in QUANTITIES),
        *(pa.field(name, pa.float64()) for name, of in named.items() if of is float),
        *(pa.field(name, pa.list_(pa.float64())) for name, of in named.items() if of is list),
        pa.field("model_digest", pa.string()),
    ]
    schema = pa.schema(columns)
    with pq.ParquetWriter(stream, schema, compression="zstd") as table:
        stages = iter(fleet.stages)
        while part := list(islice(stages, TOGETHER)):
            rows = [row for stage in part for row in _rows(stage)]
            table.write_table(pa.Table.from_pylist(rows, schema=schema))


def _rows(stage: "FleetStage") -> list[dict[str, Any]]:
    about = {
        "stage": stage.name,
        "state": stage.state,
        "reason": stage.reason,
        "serial": stage.serial,
        "model_digest": stage.outputs.get("model.json"),
    }
    return [
        {
            **about,
            "axis": axis.axis,
            "applies": axis.applies,
            **axis.values,
            **axis.parameters,
        }
        for axis in stage.axes
    ] or [about]


def _parameter_names(fleet: "Fleet") -> dict[str, type]:
    """Return the kind of every parameter, in the order in which they are first seen."""
    kinds: dict[str, type] = {}
    for stage in fleet.stages:
        for axis in stage.axes:
            if not axis.parameters.keys() <= kinds.keys():
                kinds |= {n: type(v) for n, v in axis.parameters.items() if n not in kinds}
    return kinds
