"""Stages of a batch on dask.distributed: a killed worker costs time and no result."""

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
from piezoid_cli.result_store import result_store
from piezoid_cli.workers import unreachable_by_interrupts

if TYPE_CHECKING:
    from distributed import Client

    from piezoid_reports.fleet.records import StagesOnDisk

ANSWER_s = 20.0  # within which a scheduler, and then a first worker, must answer
MIN_SUBMITTED = 64  # stages that are submitted at one time: more workers may come
# A client that waits for a night looks about less often: 8 instead of 14 ms of processor a second.
RESTFUL = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.work-stealing-interval": "1s",
    "distributed.worker.profile.enabled": False,
}


def find_stages(folder: Path, results: str, *, force: bool = False) -> tuple[StageTask, ...]:
    """Find the stages below a folder: the folders with a lab.toml that are not results.

    force  replace results although they were edited

    Raises ``RecordingError`` if there is none.
    """
    tasks = []
    root, current = os.path.realpath(folder), version("piezoid")
    for path, below, files in os.walk(root):
        # Folders that a fit or a batch wrote are no stages.
        below[:] = sorted(
            name
            for name in below
            if not lists_results(Path(path, name))
            and os.path.realpath(Path(path, name)) != os.path.realpath(results)
        )
        if LAB in files and os.path.isfile(os.path.join(path, LAB)):
            name = Path(os.path.relpath(path, root)).as_posix()
            try:
                name.encode()
            except UnicodeEncodeError as error:
                raise RecordingError(
                    f"the folder {name!r} has a name that is no text in UTF-8",
                    needed="names that can be written into the summary",
                    remedy="Rename the folder.",
                ) from error
            task = StageTask(name=name, folder=path, results=results, version=current, force=force)
            tasks.append(task)
    if not tasks:
        problem = "is not there"
        if folder.exists():
            problem = f"holds no {LAB}" if folder.is_dir() else "is a file"
        raise RecordingError(
            f"{folder} {problem}",
            needed=f"a folder of stages, each a folder with its recordings and a {LAB}",
            remedy="Check its name, or write one: piezoid init FILES... --out STAGE/lab.toml",
        )
    return tuple(tasks)


def pending_stages(tasks: Sequence[StageTask], finished: "StagesOnDisk") -> list[StageTask]:
    """Return the stages to do, and add the records of the others to ``finished``.

    Raises ``typer.BadParameter`` if results of other files or of another version would be replaced
    without ``force``, and ``OutputFolderError`` if results may not be written.
    """
    if not result_store(tasks[0].results).has_stages:
        return list(tasks)
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
            f"{len(outdated)} stages were done from other files or by another version "
            f"({', '.join(outdated[:3])}{', ...' if len(outdated) > 3 else ''}); add --force to "
            "replace their results, or name another folder"
        )
    return pending


@contextmanager
def cluster_client(scheduler: str, processes: int | None) -> "Iterator[Client]":
    """Give a client of a scheduler, or of worker processes on this machine, one thread each."""
    if find_spec("distributed") is None or find_spec("pyarrow") is None:
        raise typer.BadParameter(
            "batch needs dask[distributed] and pyarrow, which are not installed; "
            "pip install 'piezoid[batch]'"
        )
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    import dask
    from dask.system import CPU_COUNT
    from distributed import Client, LocalCluster

    with dask.config.set({"logging.distributed": "critical", **RESTFUL}):
        if scheduler:
            with _connect(scheduler) as client:
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


def _connect(scheduler: str) -> "Client":
    from distributed import Client

    try:
        client = Client(scheduler, timeout=ANSWER_s)
    except (OSError, ValueError) as error:
        raise typer.BadParameter(
            f"--scheduler {scheduler}: nothing answers there ({error}); start one with "
            "`dask scheduler`, and name the address it prints"
        ) from error
    try:
        client.wait_for_workers(1, timeout=ANSWER_s)
    except TimeoutError as error:
        client.close()
        raise typer.BadParameter(
            f"--scheduler {scheduler}: it has no worker; start one where piezoid is installed "
            f"and the recordings can be read, with `dask worker {scheduler} --nthreads 1`"
        ) from error
    return client


def run_on_workers(
    client: "Client",
    work: Callable[[StageTask], bytes],
    tasks: Sequence[StageTask],
    retries: int,
) -> Iterator[tuple[StageTask, bytes, str]]:
    """Yield every stage with its packed record, or with the reason why it broke off, as they end.

    A stage whose work raises is tried again ``retries`` times; dask gives up a stage after several
    workers died of it.
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
            yield task, b"", "the scheduler gave the work up"
        elif isinstance(error, KilledWorker):
            reason = "every worker that took it died: it may need more memory than there is"
            yield task, b"", reason
        else:
            yield task, b"", f"{type(error).__name__}: {error}"
        future.release()
        submit(1)
