"""Jobs of one command in worker processes.

A job is a frozen record, and its result does not depend on the process. If a worker is killed, its
jobs are repeated in this process.
"""

import copyreg
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import active_children, get_context
from multiprocessing.connection import Connection
from multiprocessing.resource_tracker import ensure_running
from pickle import dumps, loads
from threading import Thread
from types import MappingProxyType
from typing import Any, TypeVar

from piezoid.errors import PiezoidError
from piezoid.output_folder import interrupts_blocked
from piezoid_cli.interrupt import postponed

Progress = Callable[[str], None]
Job = TypeVar("Job")
Result = TypeVar("Result")
Work = Callable[[Job, Progress], Result]
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_MAX_MESSAGE = 1000  # characters: a pipe writes shorter messages atomically


def _frozen_mapping(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


# Records contain no other type without pickle support.
copyreg.pickle(MappingProxyType, lambda mapping: (_frozen_mapping, (dict(mapping),)))


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def unreachable_by_interrupts() -> Iterator[None]:
    """Start threads and processes in the block that do not receive Ctrl-C."""
    ensure_running()  # starting the resource tracker later would unblock the signal
    with interrupts_blocked():
        yield


class WorkerPool:
    """Worker processes, and the pipe for their progress."""

    def __init__(self, count: int, preload: Callable[[], object]) -> None:
        """Prepare ``count`` workers; each runs ``preload`` first."""
        context = get_context("spawn")
        self._reader, self._writer = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(
            count, context, initializer=_start_worker, initargs=(self._writer, preload)
        )
        self._texts: dict[int, str] = {}

    def submit(self, work: Work[Job, Result], job: Job, index: int) -> "Future[bytes]":
        """Submit a job to a worker; the future contains the pickled result, or the failure."""
        with postponed(), unreachable_by_interrupts():
            try:
                return self._executor.submit(_run_job, dumps((work, job), protocol=5), index)
            except BrokenProcessPool as error:  # a worker was killed before this job
                failed: Future[bytes] = Future()
                failed.set_exception(error)
                return failed

    def report_to(self, report: Progress) -> None:
        """Start reporting the progress of this process and of the workers."""
        self._report = report
        Thread(target=self._forward, daemon=True).start()

    def say(self, index: int, text: str) -> None:
        """Set the progress text of a job, empty if the job has ended."""
        self._texts[index] = text
        if text:
            self._report(" | ".join(self._texts[k] for k in sorted(self._texts) if self._texts[k]))

    def close(self) -> None:
        """Kill the workers and wait for the executor's thread.

        A thread that still ran at the end of Python printed a traceback below a refusal. Only the
        first call of ``shutdown`` can wait for it.
        """
        for process in active_children():
            process.kill()
        with suppress(Exception):
            self._executor.shutdown(wait=True, cancel_futures=True)
        self._writer.close()

    def _forward(self) -> None:
        with self._reader, suppress(EOFError, OSError):
            while True:
                self.say(*self._reader.recv())


@contextmanager
def worker_pool(count: int, preload: Callable[[], object]) -> Iterator[WorkerPool | None]:
    """Yield a pool of workers that import the modules of the jobs, or None for no worker."""
    if count < 1:
        yield None
        return
    pool = WorkerPool(count, preload)
    try:
        pool.submit(_do_nothing, None, -1)
        yield pool
    finally:
        pool.close()


def map_jobs(
    work: Work[Job, Result],
    jobs: Sequence[Job],
    report: Progress,
    *,
    pool: WorkerPool | None,
    cost: Callable[[Job], float],
) -> list[Result]:
    """Return ``work(job, report)`` of every job, in the order of the jobs.

    work    a function of a module, with frozen records as jobs and results
    report  receives the progress
    pool    additional workers; this process runs the job with the largest cost itself

    Raises the ``PiezoidError`` of the first job that raises one.
    """
    if pool is None or len(jobs) < 2:
        return [work(job, report) for job in jobs]
    pool.report_to(report)
    first, *remaining = sorted(range(len(jobs)), key=lambda index: -cost(jobs[index]))
    futures = {index: pool.submit(work, jobs[index], index) for index in remaining}
    results: dict[int, Result | PiezoidError] = {}
    for index in (first, *reversed(remaining)):
        if index == first or futures[index].cancel():
            results[index] = _result_of(work, jobs[index], partial(pool.say, index))
            pool.say(index, "")
    for index, job in enumerate(jobs):
        result = results.get(index)
        if index not in results:
            with suppress(Exception):  # the worker was killed or failed
                result = loads(futures[index].result())
        if result is None:
            result = _result_of(work, job, report)
        if isinstance(result, PiezoidError):
            raise result
        results[index] = result
    return [results[index] for index in range(len(jobs))]  # type: ignore[misc]


def _result_of(work: Work[Job, Result], job: Job, report: Progress) -> Result | PiezoidError:
    try:
        return work(job, report)
    except PiezoidError as refusal:
        return refusal


def _start_worker(writer: Connection, preload: Callable[[], object]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # before linear algebra is imported
    _Reports.writer = writer
    preload()


class _Reports:
    """Pipe for the progress of this worker."""

    writer: Connection


def _run_job(pickled_job: bytes, index: int) -> bytes:
    def report(text: str) -> None:
        with suppress(OSError):
            _Reports.writer.send((index, text[:_MAX_MESSAGE]))

    work, job = loads(pickled_job)
    result = _result_of(work, job, report)
    report("")
    return dumps(result, protocol=5)


def _do_nothing(_: object, __: Progress) -> None:
    """First job of a pool, which makes the workers start to import."""
