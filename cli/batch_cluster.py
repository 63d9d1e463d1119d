"""Many stages at once on dask.distributed: workers may die, the work does not."""

import logging
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from itertools import count
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, TypeVar

import typer

from piezoid.errors import RecordingError
from piezoid.manifest import lists_results
from piezoid_cli.results_place import results_place
from piezoid_cli.stage_task import LAB, Known, StageTask
from piezoid_cli.workers import unreachable_by_interrupts

if TYPE_CHECKING:
    from distributed import Client, Future

Check = Callable[[Sequence[StageTask]], Iterable[Known]]

ANSWER_s = 20.0  # within which a scheduler, and then a first worker, must answer
BUNDLE = 32  # stages that are given to a worker at once, at most
LEAST_WINDOW = 64  # bundles that are given out at one time: more workers may come
# A client that waits for a night looks about less often: 8 instead of 14 ms of processor a second.
RESTFUL = {
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.work-stealing-interval": "1s",
    "distributed.worker.profile.enabled": False,
}

Answer = TypeVar("Answer")


@contextmanager
def workers(scheduler: str, processes: int | None) -> "Iterator[Client]":
    """Give a client of somebody's scheduler, or of processes of our own, one thread each."""
    _check_installed()
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    import dask
    from dask.system import CPU_COUNT
    from distributed import Client, LocalCluster

    with dask.config.set({"logging.distributed": "critical", **RESTFUL}):
        if scheduler:
            with _client(scheduler) as client:
                yield client
            return
        with unreachable_by_interrupts():  # workers are begun by its thread
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


def answers(
    client: "Client",
    work: Callable[[Sequence[StageTask]], Sequence[Answer]],
    tasks: Sequence[StageTask],
    retries: int,
    broken_off: Callable[[StageTask, str], Answer],
) -> Iterator[Answer]:
    """Yield what becomes of every task, in the order in which they end.

    work        done by a worker of some tasks; it may leave the last of them for others
    broken_off  what is said of a task that never came to an end, and why

    A scheduler costs about two milliseconds for whatever it is asked for, so that several tasks
    are given at once: fewer towards the end, and never more than a window of them. A bundle whose
    worker dies is given to another one; after it has failed ``retries`` times more, or has taken
    several workers with it, its tasks are given one by one, and the one that fails again is
    ``broken_off``.
    """
    from distributed import as_completed

    waiting, run = deque(tasks), token_hex(4)
    threads = max(sum(client.nthreads().values()), 1)
    window = max(LEAST_WINDOW, 2 * threads)
    submitted: dict[Future, list[StageTask]] = {}
    ended = as_completed(with_results=True, raise_errors=False)

    def give(bundle: list[StageTask]) -> None:
        key = f"stages-{run}-{next(numbers)}"
        future = client.submit(work, bundle, retries=retries, pure=False, key=key)
        submitted[future] = bundle
        ended.add(future)

    def refill() -> None:
        while waiting and len(submitted) < window:
            size = min(bundle_size(len(waiting), threads), len(waiting))
            give([waiting.popleft() for _ in range(size)])

    numbers = count()
    refill()
    for future, found in ended:
        bundle = submitted.pop(future)
        if future.status == "finished":
            yield from found
            waiting.extendleft(reversed(bundle[len(found) :]))
        elif len(bundle) > 1:
            for task in bundle:
                give([task])
        else:
            yield broken_off(bundle[0], _about(found))
        future.release()
        refill()


def bundle_size(waiting: int, threads: int) -> int:
    """Return how many tasks are given at once: a fair share of what is left, in four rounds."""
    return min(max(waiting // (4 * threads), 1), BUNDLE)


def _about(failure: object) -> str:
    from distributed.scheduler import KilledWorker

    error = failure[1] if isinstance(failure, tuple) else None
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


def stages_of(folder: Path, results: str) -> tuple[StageTask, ...]:
    """Find the stages of a folder by their lab.toml, of which nothing is read here."""
    tasks = []
    root, now = os.path.realpath(folder), version("piezoid")
    for place, below, files in os.walk(root):
        below[:] = sorted(name for name in below if not _is_result(Path(place, name), results))
        if LAB in files and os.path.isfile(os.path.join(place, LAB)):
            name = Path(os.path.relpath(place, root)).as_posix()
            _check_name(name)
            tasks.append(StageTask(name=name, folder=place, results=results, version=now))
    if not folder.is_dir():
        raise RecordingError(
            f"{folder} is {'a file' if folder.exists() else 'not there'}",
            needed=f"a folder of stages, each with its recordings and a {LAB}",
            remedy="Check its name.",
        )
    if not tasks:
        raise RecordingError(
            f"{folder}: no folder below it holds a {LAB}",
            needed=f"one folder for each stage, with its recordings and a {LAB}",
            remedy="Write one with `piezoid init FILES... --out STAGE/lab.toml`.",
        )
    return tuple(tasks)


def _is_result(folder: Path, results: str) -> bool:
    """Return whether a folder holds what a fit or a batch wrote: that is no stage to be done."""
    return lists_results(folder) or os.path.realpath(folder) == os.path.realpath(results)


def _check_name(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise RecordingError(
            f"the folder {name!r} has a name that is no text in UTF-8",
            needed="names that can be written into the summary",
            remedy="Rename the folder.",
        ) from error


def waiting_of(
    tasks: Sequence[StageTask],
    check: Check,
    *,
    force: bool,
    finished: Callable[[str, bytes], None],
) -> list[StageTask]:
    """Return what is to be done, and tell what is finished.

    check     compares what is kept of stages with their files; done by workers
    finished  given name and packed record of every stage whose inputs and version are the same

    Raises ``typer.BadParameter`` where results would be replaced without ``force``, and
    ``OutputFolderError`` where a stage's folder holds what piezoid did not write.
    """
    done: set[str] = set()
    changed: list[str] = []
    for known in check(tasks) if results_place(tasks[0].results).begun else ():
        if known.refusal:
            raise known.refusal
        if known.packed is not None:
            done.add(known.name)
            finished(known.name, known.packed)
        elif known.changed:
            changed.append(known.name)
    if changed and not force:
        changed.sort()
        raise typer.BadParameter(
            f"{len(changed)} stages were done from other files or by another version "
            f"({', '.join(changed[:3])}{', ...' if len(changed) > 3 else ''}); add --force to "
            "replace their results, or name another folder"
        )
    return [task for task in tasks if task.name not in done]
