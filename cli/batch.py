"""`piezoid batch`: calibrate a folder of stages and summarise them on one page."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import typer

from piezoid_cli.options import JsonFile, Quiet
from piezoid_cli.tables import table
from piezoid_cli.terminal import display, print_raw, show_progress

if TYPE_CHECKING:
    from distributed import Client

    from piezoid_cli.batch_stage import StageTask
    from piezoid_reports.fleet.records import Fleet, StagesOnDisk

ROW_GROUP = 5000  # stages whose rows are in memory at the same time
MAX_REASONS = 200  # stages that did not pass and are listed on the terminal


def batch(
    folder: Annotated[Path, typer.Argument(help="Folder with one subfolder per stage.")],
    out: Annotated[
        str,
        typer.Option(
            help="Folder for the results, or a URL that fsspec can write to; an existing batch "
            "is resumed.",
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
        bool, typer.Option("--force", help="Recalibrate stages whose files have changed.")
    ] = False,
    quiet: Quiet = False,
    json: JsonFile = False,
) -> None:
    """Calibrate many stages: every subfolder with recordings and a lab.toml.

    Writes stages/NAME/ as `piezoid fit` does, summary.html (spread of the parameters, outliers,
    drift over serial numbers, failures with reasons), parameters.parquet and batch.json.

    Workers write the results, so they must see --out and FOLDER under the same names.
    An --out such as s3://night/results needs the package for that store, here s3fs.

    If a worker is killed, its stage is calibrated again. A second run skips finished stages if
    their files and the version of piezoid are unchanged.

    Exit status 1 means that at least one stage did not pass; the summary gives the reasons.

    [bold]Examples[/bold]

    piezoid batch night/ --out results/

    piezoid batch night/ --out results/ --scheduler tcp://10.0.0.5:8786 --json

    piezoid batch night/ --out s3://night/results --scheduler tcp://10.0.0.5:8786
    """
    from piezoid_cli.batch_cluster import cluster_client, find_stages
    from piezoid_cli.result_store import result_store
    from piezoid_reports.fleet.records import Fleet, StagesOnDisk

    tasks = find_stages(folder, out, force=force)
    result_store(out, force=force).check()
    with StagesOnDisk() as stages:
        with (
            cluster_client(scheduler, workers) as client,
            show_progress(quiet=quiet or json) as progress,
        ):
            n_earlier = calibrate_stages(client, tasks, stages, retries, progress)
        fleet = Fleet(name=folder.resolve().name, stages=stages)
        write_summary(out, fleet, printed=json, force=force)
        if not (quiet or json):
            _show(fleet, n_earlier, out)
        if not fleet.passed:
            raise typer.Exit(1)


def calibrate_stages(
    client: "Client",
    tasks: "Sequence[StageTask]",
    stages: "StagesOnDisk",
    retries: int = 2,
    progress: Callable[[str], None] = lambda _: None,
    *,
    work: "Callable[[StageTask], bytes] | None" = None,
) -> int:
    """Calibrate the unfinished stages on workers, which write the results.

    stages    receives the record of every stage
    progress  called with the number of finished stages and the name of the latest, as a text
    work      calibrates one stage on a worker; default: ``run_task``

    Returns the number of stages that an earlier run had finished.
    """
    from piezoid.errors import OutputFolderError
    from piezoid_cli.batch_cluster import pending_stages, run_on_workers
    from piezoid_cli.batch_stage import run_task
    from piezoid_cli.result_store import RECORD, result_store
    from piezoid_reports.fleet.records import CRASHED, FleetStage

    store = result_store(tasks[0].results)
    pending = pending_stages(tasks, stages)
    n_earlier = len(stages)
    progress(f"{n_earlier} of {len(tasks)} stages done")
    store.create()
    for task, packed, failure in run_on_workers(client, work or run_task, pending, retries):
        if failure:
            crashed = FleetStage(
                name=task.name, state=CRASHED, reason=failure, version=task.version
            )
            packed = crashed.packed()
            with suppress(OutputFolderError):  # the user may have written files there meanwhile
                store.write_stage(task.name, {RECORD: crashed.to_json()})
        stages.add(task.name, packed)
        progress(f"{len(stages)} of {len(tasks)} stages done: {task.name}")
    store.remove_unfinished(task.name for task in tasks)
    return n_earlier


def write_summary(out: str, fleet: "Fleet", *, printed: bool = False, force: bool = False) -> None:
    """Write the files common all stages, batch.json last.

    printed  also print batch.json
    force    replace an edited summary
    """
    from piezoid_cli.result_store import SUMMARY, result_store
    from piezoid_reports.fleet.sections import render_fleet

    def write_record(stream: BinaryIO) -> None:
        fleet.write_json(stream)
        if printed:
            stream.seek(0)
            for line in stream:
                print_raw(line)

    store = result_store(out, force=force)
    page, parameters, record = SUMMARY
    store.write_file(page, lambda stream: stream.write(render_fleet(fleet).encode()))
    store.write_file(parameters, lambda stream: write_table(fleet, stream))
    store.write_file(record, write_record)


def _show(fleet: "Fleet", n_earlier: int, out: str) -> None:
    from piezoid_cli.result_store import SUMMARY
    from piezoid_reports.fleet.records import PASSED, STAGES, STATES

    count = fleet.counts
    rows = [
        (str(count[state]), state, meaning)
        for state, meaning in STATES.items()
        if count.get(state)
    ]
    title = f"batch {fleet.name}: {len(fleet.stages)} stages"
    display(table(title, ("stages", "state", "meaning"), rows, n_words=3))
    if n_earlier:
        display(f"{n_earlier} were finished in an earlier run")
    if n_uncontrolled := fleet.without_controller:
        display(
            f"{n_uncontrolled} passed without a controller: their reports state what is missing"
        )
    for stage in islice((stage for stage in fleet.stages if stage.reason), MAX_REASONS):
        display(f"{stage.name}: {stage.state}: {stage.reason}", "dim")
    n_omitted = len(fleet.stages) - count.get(PASSED, 0) - MAX_REASONS
    if n_omitted > 0:
        display(f"and {n_omitted} more; parameters.parquet lists their reasons")
    summary, *paths = (f"{out.rstrip('/')}/{name}" for name in (*SUMMARY[:2], f"{STAGES}/"))
    display(f"summary: {summary}")
    display(f"also: {', '.join(paths)}")


def write_table(fleet: "Fleet", stream: BinaryIO) -> None:
    """Write one row per axis as Parquet; a stage without results is a row without an axis."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from piezoid_reports.fleet.statistics import QUANTITIES

    types = {float: pa.float64(), list: pa.list_(pa.float64())}
    parameters: dict[str, type] = {}
    for stage in fleet.stages:
        for axis in stage.axes:
            if not axis.parameters.keys() <= parameters.keys():
                parameters |= {n: type(v) for n, v in axis.parameters.items()}
    schema = pa.schema(
        [
            *((name, pa.string()) for name in ("stage", "state", "reason", "axis")),
            ("serial", pa.int64()),
            ("applies", pa.bool_()),
            *((quantity.name, pa.float64()) for quantity in QUANTITIES),
            *((n, types[kind]) for kind in types for n, k in parameters.items() if k is kind),
            ("model_digest", pa.string()),
        ]
    )
    with pq.ParquetWriter(stream, schema, compression="zstd") as table:
        stages = iter(fleet.stages)
        while group := list(islice(stages, ROW_GROUP)):
            rows: list[dict[str, Any]] = []
            for stage in group:
                common = {
                    "stage": stage.name,
                    "state": stage.state,
                    "reason": stage.reason,
                    "serial": stage.serial,
                    "model_digest": stage.outputs.get("model.json"),
                }
                rows += [
                    {**common, "axis": a.axis, "applies": a.applies, **a.values, **a.parameters}
                    for a in stage.axes
                ] or [common]
            table.write_table(pa.Table.from_pylist(rows, schema=schema))
