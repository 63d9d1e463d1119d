"""Calibrate the stages of a batch on dask.distributed, which repeats the work of lost workers."""

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.metadata import version
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING

import typer

from piezoid.errors import RecordingError
from piezoid.manifest import lists_results
from piezoid_cli.batch_stage import LAB, StageTask, earlier_result
from piezoid_cli.workers import unreachable_by_interrupts

if TYPE_CHECKING:
    from distributed import Client

    from piezoid_reports.fleet.records import StagesOnDisk

TIMEOUT_s = 20.0  # for the scheduler to answer, and then for its first worker
MIN_SUBMITTED = 64  # stages submitted at the same time: more workers may join
# Longer intervals of housekeeping: a waiting client needs 8 instead of 14 ms of CPU per second.
DASK_INTERVALS = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.work-stealing-interval": "1s",
    "distributed.worker.profile.enabled": False,
}


def find_stages(folder: Path, results: str, *, force: bool = False) -> tuple[StageTask, ...]:
    """Return the stages in a folder: the subfolders with a lab.toml that are not results.

    force  replace edited results

    Raises ``RecordingError`` without a stage.
    """
    tasks = []
    root, current = os.path.realpath(folder), version("piezoid")
    for path, subfolders, files in os.walk(root):
        # Folders that a fit or a batch wrote are not stages.
        subfolders[:] = sorted(
            name
            for name in subfolders
            if not lists_results(Path(path, name))
            and os.path.realpath(Path(path, name)) != os.path.realpath(results)
        )
        if LAB in files and os.path.isfile(os.path.join(path, LAB)):
            name = Path(os.path.relpath(path, root)).as_posix()
            try:
                name.encode()
            except UnicodeEncodeError as error:
                raise RecordingError(
                    f"the name of the folder {name!r} is not valid UTF-8",
                    needed="names that can be written into the summary",
                    remedy="Rename the folder.",
                ) from error
            task = StageTask(name=name, folder=path, results=results, version=current, force=force)
            tasks.append(task)
    if not tasks:
        problem = "does not exist"
        if folder.exists():
            problem = f"contains no {LAB}" if folder.is_dir() else "is a file"
        raise RecordingError(
            f"{folder} {problem}",
            needed=f"a folder of stages, each a folder with its recordings and a {LAB}",
            remedy="Check the name, or write a lab.toml: piezoid init FILES... --out "
            "STAGE/lab.toml",
        )
    return tuple(tasks)


def pending_stages(tasks: Sequence[StageTask], finished: "StagesOnDisk") -> list[StageTask]:
    """Return the unfinished stages, and add the records of the finished ones to ``finished``.

    Raises ``typer.BadParameter`` if results of other files or of another version would be replaced
    without ``force``, and ``OutputFolderError`` if results may not be written.
    """
    pending, outdated = [], []
    with ThreadPoolExecutor() as threads:
        results = threads.map(earlier_result, tasks)
        for task, (record, is_current) in zip(tasks, results, strict=True):
            if record is not None and is_current:
                finished.add(task.name, record.packed())
                continue
            pending.append(task)
            outdated += [] if record is None else [task.name]
    if outdated and not tasks[0].force:
        raise typer.BadParameter(
            f"{len(outdated)} stages were calibrated from other files or by another version "
            f"({', '.join(outdated[:3])}{', ...' if len(outdated) > 3 else ''}); add --force to "
            "replace their results, or name another folder"
        )
    return pending


@contextmanager
def cluster_client(scheduler: str, processes: int | None) -> "Iterator[Client]":
    """Yield a client of a scheduler, or of single-threaded workers on this machine."""
    if find_spec("distributed") is None or find_spec("pyarrow") is None:
        raise typer.BadParameter(
            "batch needs dask[distributed] and pyarrow, which are not installed; "
            "pip install 'piezoid[batch]'"
        )
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    import dask
    from dask.system import CPU_COUNT
    from distributed import Client, LocalCluster

    with dask.config.set({"logging.distributed": "critical", **DASK_INTERVALS}):
        if scheduler:
            try:
                client = Client(scheduler, timeout=TIMEOUT_s)
            except (OSError, ValueError) as error:
                raise typer.BadParameter(
                    f"--scheduler {scheduler}: no answer ({error}); start a scheduler with "
                    "`dask scheduler`, and name the address that it prints"
                ) from error
            with client:
                try:
                    client.wait_for_workers(1, timeout=TIMEOUT_s)
                except TimeoutError as error:
                    raise typer.BadParameter(
                        f"--scheduler {scheduler}: no worker; on a machine with piezoid and "
                        f"access to the recordings, run `dask worker {scheduler} --nthreads 1`"
                    ) from error
                yield client
            return
        with unreachable_by_interrupts():  # its thread starts the workers
            cluster = LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # any free port: another batch may run here
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
        with cluster, Client(cluster) as client:
            count = processes or CPU_COUNT
            cluster.scale(count)
            client.wait_for_workers(count)
            yield client


def run_on_workers(
    client: "Client", work: Callable[[StageTask], bytes], tasks: Sequence[StageTask], retries: int
) -> Iterator[tuple[StageTask, bytes, str]]:
    """Yield every completed stage with its packed record, or with the reason of its failure.

    A stage that raises is repeated ``retries`` times. Dask gives up a stage after it has killed
    several workers.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    waiting, run = enumerate(tasks), token_hex(4)
    submitted = {}
    completed = as_completed(with_results=True, raise_errors=False)

    def submit(count: int) -> None:
        for number, task in islice(waiting, count):
            key = f"stage-{run}-{number}"
            future = client.submit(work, task, retries=retries, pure=False, key=key)
            submitted[future] = task
            completed.add(future)

    submit(max(MIN_SUBMITTED, 2 * sum(client.nthreads().values())))
    for future, result in completed:
        task = submitted.pop(future)
        error = result[1] if isinstance(result, tuple) else None
        if future.status == "finished":
            yield task, result, ""
        elif error is None:
            yield task, b"", "the scheduler cancelled the work"
        elif isinstance(error, KilledWorker):
            reason = "every worker with this stage died: it may need more memory"
            yield task, b"", reason
        else:
            yield task, b"", f"{type(error).__name__}: {error}"
        future.release()
        submit(1)
