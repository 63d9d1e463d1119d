"""Jobs of one command side by side: in this process, and in as many more as there are cores.

This process takes jobs as well, and begins with the heaviest: it is there already. The others are
started for what is left, or ahead of it, and have one thread of linear algebra each; what a job
gives does not depend on who does it.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from threading import Lock, Thread
from typing import Any, TypeVar

from piezoid.errors import PiezoidError
from piezoid_cli.other_process import Other, others

Told = Callable[[str], None]
Job = TypeVar("Job")
Result = TypeVar("Result")


def usable_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def side_by_side(
    work: Callable[[Job, Told], Result],
    jobs: Sequence[Job],
    told: Told,
    *,
    processes: int,
    weight: Callable[[Job], float],
    begun: Sequence[Other] = (),
) -> list[Result]:
    """Return ``work(job, told)`` of every job, in their order.

    work       found by its name in its module; jobs and results are frozen records
    told       says what is being done, here and elsewhere
    processes  at most so many, this one among them; 1 does one job after the other
    weight     of a job: with several processes, the heaviest begin
    begun      processes that began before; they come as soon as they are free. Where they are too
               few, more begin

    A ``PiezoidError`` is raised as if every job had been done here, that of the first job in
    order. Whatever else ends another process, a mistake of ours, memory that is full, somebody's
    kill, costs time and no result: its job is done here. None of them outlives this call.
    """
    count = min(processes, len(jobs)) - 1
    if count < 1:
        return [work(job, told) for job in jobs]
    order = sorted(range(len(jobs)), key=lambda index: -weight(jobs[index]))
    board = _Board(order, told)
    settled: list[Future[Result]] = [Future() for _ in jobs]
    with others(count - len(begun)) as more:
        for other in (*begun[:count], *more):
            Thread(target=_serve, args=(other, work, jobs, board, settled), daemon=True).start()
        for index in board.taken():
            _settle(settled[index], work, jobs[index], board.teller(index))
            board.done(index, settled[index])
        return [_result(s, work, job, told) for s, job in zip(settled, jobs, strict=True)]


class _LostError(Exception):
    """A process ended without an answer."""


def _result(
    settled: "Future[Result]", work: Callable[[Job, Told], Result], job: Job, told: Told
) -> Result:
    try:
        return settled.result()
    except _LostError:
        return work(job, told)


def _settle(
    settled: "Future[Result]", work: Callable[[Job, Told], Result], job: Job, told: Told
) -> None:
    try:
        settled.set_result(work(job, told))
    except PiezoidError as refusal:
        settled.set_exception(refusal)


def _serve(
    other: Other,
    work: Callable[[Job, Told], Result],
    jobs: Sequence[Job],
    board: "_Board",
    settled: "Sequence[Future[Result]]",
) -> None:
    """Let one process do jobs until none is left, or until it is gone."""
    if not other.is_there():
        return
    for index in board.taken():
        try:
            settled[index].set_result(other.ask(work, jobs[index], board.teller(index)).result())
        except PiezoidError as refusal:
            settled[index].set_exception(refusal)
        except Exception:
            settled[index].set_exception(_LostError())
            board.done(index, settled[index])
            return
        board.done(index, settled[index])


class _Board:
    """Which jobs wait, and what is being done of those that do not."""

    def __init__(self, order: Sequence[int], told: Told) -> None:
        self._lock = Lock()
        self._waiting = list(order)
        self._doing: dict[int, str] = {}
        self._told = told

    def taken(self) -> Iterator[int]:
        """Give one job after the other, until none waits."""
        while True:
            with self._lock:
                if not self._waiting:
                    return
                index = self._waiting.pop(0)
            yield index

    def done(self, index: int, settled: "Future[Any]") -> None:
        """Forget a job; behind a refusal, nothing begins that stands behind it."""
        with self._lock:
            self._doing.pop(index, None)
            if settled.exception() is not None:
                self._waiting = [other for other in self._waiting if other < index]

    def teller(self, index: int) -> Told:
        """Return what a job says what it does to."""

        def told(text: str) -> None:
            with self._lock:
                self._doing[index] = text
                said = " | ".join(self._doing[place] for place in sorted(self._doing))
            self._told(said)

        return told
