"""Thread pool for independent fits, progress messages, and one thread for linear algebra.

Fits spend nearly all of their time in compiled code that releases the interpreter's lock, so
threads run in parallel. Linear algebra is limited to one thread: the matrices are small, so that
threads of the library mostly wait for each other (2.3 times slower on two idle cores, 40 times on
two busy cores), and the order of their sums changes the last bits of a result.
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
Returned = TypeVar("Returned")

Value = TypeVar("Value", covariant=True)

Item = TypeVar("Item")
Result = TypeVar("Result")
Other = TypeVar("Other")


class Once(Generic[Value]):
    """``functools.cached_property`` of Python 3.12, for Python 3.11, which locks all instances.

    Two threads may both compute the value; both return the value that was stored first.
    """

    def __init__(self, make: Callable[[Any], Value]) -> None:
        """Wrap the method that computes the value."""
        self._make = make
        self.__doc__ = make.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        """Store the name of the attribute."""
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type | None = None) -> Value: ...
    def __get__(self, instance: object | None, owner: type | None = None) -> Self | Value:
        """Compute and store the value; later reads find it in the instance."""
        if instance is None:
            return self
        value: Value = vars(instance).setdefault(self._name, self._make(instance))
        return value


@dataclass(frozen=True, kw_only=True)
class Executor:
    """Number of worker threads and the callback for progress messages.

    progress  called with a short text, from any thread, one call at a time
    threads   number of worker threads; results do not depend on it
    """

    progress: Callable[[str], None] = lambda _: None
    threads: int = 1
    _lock: AbstractContextManager[bool] = field(default_factory=Lock, repr=False)

    def __post_init__(self) -> None:
        if self.threads < 1:
            raise ValueError(f"found {self.threads} threads, but at least 1 is needed")

    def report(self, text: str) -> None:
        """Call ``progress`` with a message, from one thread at a time."""
        with self._lock:
            self.progress(text)

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Return ``work(item)`` of all items, in their order."""
        items = list(items)
        if min(self.threads, len(items)) < 2:
            return [work(item) for item in items]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(work, items))

    def run_both(
        self, first: Callable[[], Result], second: Callable[[], Other]
    ) -> tuple[Result, Other]:
        """Run two functions concurrently and return their results."""
        if self.threads < 2:
            return first(), second()
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(second)
            return first(), future.result()


SERIAL = Executor()


def on_one_thread(compute: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Limit linear algebra to one thread while the function runs; the limit is process-wide."""

    @wraps(compute)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        with threadpool_limits(limits=1, user_api="blas"):
            return compute(*args, **kwargs)

    return limited
