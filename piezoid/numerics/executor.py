"""A thread pool for independent refits, and the progress they report.

Refits of different effects are independent, and nearly all of their time passes in compiled code
that releases the interpreter's lock.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from threading import Lock
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Other = TypeVar("Other")


def _ignore(_: str) -> None:
    """Report to nobody."""


@dataclass(frozen=True, kw_only=True)
class Executor:
    """How many threads work at once, and who is told of the progress.

    progress  called with a few words, by whichever thread, one at a time
    threads   the results do not depend on it
    """

    progress: Callable[[str], None] = _ignore
    threads: int = 1
    _lock: AbstractContextManager[bool] = field(default_factory=Lock, repr=False)

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise ValueError(f"found {self.threads} threads, but at least 1 is needed")

    def report(self, text: str) -> None:
        """Report what is being done; a pipe to another process takes one message at a time."""
        with self._lock:
            self.progress(text)

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Return ``work(item)`` of all items, in their order."""
        waiting = list(items)
        if min(self.threads, len(waiting)) < 2:
            return [work(item) for item in waiting]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(work, waiting))

    def both(self, one: Callable[[], Result], other: Callable[[], Other]) -> tuple[Result, Other]:
        """Return both results."""
        if self.threads < 2:
            return one(), other()
        with ThreadPoolExecutor(1) as pool:
            second = pool.submit(other)
            return one(), second.result()


SERIAL = Executor()
