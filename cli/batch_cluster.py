"""Many stages at once on dask.distributed: workers may die, the work does not."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from piezoid_cli.stage_task import StageDone, StageTask, broken, run_stage
from piezoid_reports.fleet.records import CRASHED

if TYPE_CHECKING:
    from distributed import Client, Future

ANSWER_s = 20.0  # within which a scheduler, and then a first worker, must answer


@contextmanager
def workers(scheduler: str, count: int | None) -> "Iterator[Client]":
    """Give a client of somebody's scheduler, or of processes of our own, one thread each."""
    _check_installed()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    import dask
    from distributed import Client, LocalCluster

    with dask.config.set({"logging.distributed": "critical"}):
        if scheduler:
            with _client(scheduler) as client:
                yield client
            return
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # any free port: another batch may run here
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client


def results(client: "Client", tasks: Sequence[StageTask], retries: int) -> Iterator[StageDone]:
    """Yield what becomes of every task, in the order in which they end.

    A task whose worker dies is given to another one; after it has failed ``retries`` times more,
    or has taken several workers with it, it is a stage that broke off.
    """
    from distributed import as_completed

    asked = {
        client.submit(run_stage, task, retries=retries, pure=False, key=f"stage-{task.name}"): task
        for task in tasks
    }
    for future in as_completed(asked):
        yield _outcome(future, asked[future])
        future.release()


def _outcome(future: "Future", task: StageTask) -> StageDone:
    if future.status == "finished":
        done: StageDone = future.result()
        return done
    error = future.exception() if future.status == "error" else None
    return StageDone(stage=broken(task, CRASHED, _about(error)), files={})


def _about(error: BaseException | None) -> str:
    from distributed.scheduler import KilledWorker

    if error is None:
        return "the scheduler gave the work up"
    if isinstance(error, KilledWorker):
        return "every worker that took it died: it may need more memory than there is"
    return f"{type(error).__name__}: {error}"


@contextmanager
def _client(scheduler: str) -> "Iterator[Client]":
    from distributed import Client

    try:
        client = Client(scheduler, timeout=ANSWER_s)
    except (OSError, ValueError) as error:
        raise typer.BadParameter(
            f"--scheduler {scheduler}: nothing answers there ({error}); start one with "
            "`dask scheduler`, and name the address it prints"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=ANSWER_s)
        except TimeoutError as error:
            raise typer.BadParameter(
                f"--scheduler {scheduler}: it has no worker; start one where piezoid is installed "
                f"and the recordings can be read, with `dask worker {scheduler} --nthreads 1`"
            ) from error
        yield client


def _check_installed() -> None:
    from importlib.util import find_spec

    if find_spec("distributed") is None or find_spec("pyarrow") is None:
        raise typer.BadParameter(
            "batch needs dask[distributed] and pyarrow, which are not installed; "
            "pip install 'piezoid[batch]'"
        )
