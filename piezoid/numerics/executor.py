"""A thread pool for independent refits, and the progress they report.

Refits of different effects are independent, and nearly all of their time passes in compiled code
that releases the interpreter's lock.

Linear algebra by one thread.

Our matrices are small: the threads of a linear algebra library spend their time waiting for each
other (a fit takes 2.3 times as long on two idle cores, 40 times on two busy ones), and how a sum
is shared among them changes its last bits. Whoever wants several cores asks the verb for
``threads`` of ours.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import wraps
from threading import Lock
from typing import Any, Generic, ParamSpec, Self, TypeVar, overload

from threadpoolctl import threadpool_limits

Arguments = ParamSpec("Arguments")
Found = TypeVar("Found")

Value = TypeVar("Value", covariant=True)

Item = TypeVar("Item")
Result = TypeVar("Result")
Other = TypeVar("Other")


class Once(Generic[Value]):
    """What ``functools.cached_property`` is from Python 3.12 on: no record waits for another.

    Before, one lock for all records of a class let only one thread make anything. Two threads that
    ask at once may both make the value; both are given the one that was there first.
    """

    def __init__(self, make: Callable[[Any], Value]) -> None:
        """Take the method that makes the value."""
        self._make = make
        self.__doc__ = make.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        """Learn under which name the value is kept."""
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type | None = None) -> Value: ...
    def __get__(self, instance: object | None, owner: type | None = None) -> Self | Value:
        """Make the value; once it is kept, nobody comes here."""
        if instance is None:
            return self
        kept: Value = vars(instance).setdefault(self._name, self._make(instance))
        return kept


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


def on_one_thread(compute: Callable[Arguments, Found]) -> Callable[Arguments, Found]:
    """Return the function with linear algebra held to one thread while it runs.

    The limit is the process's, as the libraries have it, and is lifted at the end.
    """

    @wraps(compute)
    def held(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Found:
        with threadpool_limits(limits=1, user_api="blas"):
            return compute(*args, **kwargs)

    return held
