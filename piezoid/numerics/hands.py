"""Hands: who does the work of a search, and who is told of it.

Refits of different effects have nothing to do with each other, and nearly all of their time passes
in compiled code that other threads need not wait for.
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


def _to_nobody(_: str) -> None:
    """Say nothing."""


@dataclass(frozen=True, kw_only=True)
class Hands:
    """How many work at once, and who is told what is being done.

    told   called with a few words, by whichever thread does it, one at a time
    count  threads; what is found does not depend on it
    """

    told: Callable[[str], None] = _to_nobody
    count: int = 1
    _one_at_a_time: AbstractContextManager[bool] = field(default_factory=Lock, repr=False)

    def __post_init__(self) -> None:
        if self.count < 1:
            raise ValueError(f"{self.count} threads cannot do anything, 1 can")

    def say(self, text: str) -> None:
        """Tell what is being done: a channel to another process takes one word after the other."""
        with self._one_at_a_time:
            self.told(text)

    def each(self, work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Return ``work(item)`` of all items, in their order."""
        waiting = list(items)
        if min(self.count, len(waiting)) < 2:
            return [work(item) for item in waiting]
        with ThreadPoolExecutor(self.count) as threads:
            return list(threads.map(work, waiting))

    def both(self, one: Callable[[], Result], other: Callable[[], Other]) -> tuple[Result, Other]:
        """Return what both make."""
        if self.count < 2:
            return one(), other()
        with ThreadPoolExecutor(1) as thread:
            made = thread.submit(other)
            return one(), made.result()


ALONE = Hands()
