"""One more process of our own: it loads what jobs need, then does one job after the other.

Records go to and fro with their arrays as they lie in memory, not copied.
"""

import io
import os
import pickle
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from multiprocessing.resource_tracker import ensure_running
from types import MappingProxyType
from typing import Any, TypeVar

from piezoid.errors import PiezoidError

Told = Callable[[str], None]
Ready = Callable[[], None]
Job = TypeVar("Job")
Result = TypeVar("Result")
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def _silent(_: str) -> None:
    """Say nothing."""


def _at_once() -> None:
    """Have nothing to load."""


class Other:
    """A process at the other end of a channel; it does what it is asked in the order of asking."""

    def __init__(self, channel: Connection) -> None:
        """Wait, in a thread of its own, until the process has loaded what it needs."""
        self._channel = channel
        self._line = ThreadPoolExecutor(1)
        self._last: Future[Any] = self._line.submit(self._answer, _silent)

    def ask(
        self, work: Callable[[Job, Told], Result], job: Job, told: Told = _silent
    ) -> "Future[Result]":
        """Return what will be ``work(job, told)``.

        It holds the ``PiezoidError`` that the work raised, or any other exception where the
        process or the job was lost on the way.
        """
        found = self._line.submit(self._done, work, job, told)
        self._last = found
        return found

    def is_there(self) -> bool:
        """Wait until all that was asked is done, and tell whether the process still lives."""
        try:
            self._last.result()
        except PiezoidError:
            return True
        except Exception:
            return False
        return True

    def leave(self) -> None:
        """Ask nothing any more."""
        self._line.shutdown(wait=False, cancel_futures=True)

    def _done(self, work: Callable[[Job, Told], Result], job: Job, told: Told) -> Any:
        send(self._channel, (work, job))
        return self._answer(told)

    def _answer(self, told: Told) -> Any:
        while True:
            kind, content = received(self._channel)
            if kind == "told":
                told(content)
            elif kind == "refused":
                raise content
            else:
                return content


@contextmanager
def others(count: int, ready: Ready = _at_once) -> Iterator[list[Other]]:
    """Give processes of our own; they end with the block, whatever they do.

    ready  what each does first, such as loading what jobs need; found by its name in its module
    """
    context = get_context("spawn")
    processes: list[SpawnProcess] = []
    found: list[Other] = []
    try:
        for _ in range(count):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, ready), daemon=True)
            with suppress(OSError), theirs, _postponed():  # no room for one more: fewer do it all
                process.start()
                processes.append(process)
                found.append(Other(ours))
        yield found
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()
        for other in found:
            other.leave()


@contextmanager
def _postponed() -> Iterator[None]:
    """Hear Ctrl-C only after the block, and let whoever is started in it not hear it at all.

    Who is started inherits that the signal is blocked here. Another thread of this process may be
    handed it nevertheless, and ignoring it meanwhile would lose it: it is noted, and raised later.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    heard: list[int] = []
    ensure_running()  # beginning its process unblocks the signal
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    hears = signal.signal(signal.SIGINT, lambda number, _: heard.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, hears)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if heard:
            signal.raise_signal(signal.SIGINT)


def _work(channel: Connection, ready: Ready) -> None:
    """Do what comes until nobody is there any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(_THREADS, "1"))  # before anybody loads linear algebra
    with suppress(Exception):  # where the job is done again, it shows itself
        ready()
        send(channel, ("done", None))
        while True:
            work, job = received(channel)
            try:
                answer = ("done", work(job, lambda text: send(channel, ("told", text))))
            except PiezoidError as refusal:
                answer = ("refused", refusal)
            send(channel, answer)


def send(channel: Connection, record: object) -> None:
    """Send a record whole; ``received`` at the other end of the channel gives it back.

    Only what a record holds besides its arrays becomes a letter: the arrays follow from where
    they are, and arrive read-only, as they are in a record.
    """
    arrays: list[pickle.PickleBuffer] = []
    letter = io.BytesIO()
    _Letter(letter, protocol=5, buffer_callback=arrays.append).dump(record)
    channel.send_bytes(len(arrays).to_bytes(8, "little"))
    channel.send_bytes(letter.getbuffer())
    for array in arrays:
        channel.send_bytes(array.raw())


def received(channel: Connection) -> Any:
    """Return what the other end sent; raises ``EOFError`` where it is gone."""
    count = int.from_bytes(channel.recv_bytes(), "little")
    letter = channel.recv_bytes()
    return pickle.loads(letter, buffers=[channel.recv_bytes() for _ in range(count)])


class _Letter(pickle.Pickler):
    def reducer_override(self, thing: object) -> Any:
        if isinstance(thing, MappingProxyType):  # which alone of what is frozen does not pickle
            return _view, (dict(thing),)
        return NotImplemented


def _view(held: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(held)
