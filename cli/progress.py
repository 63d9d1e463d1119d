"""What is being done and for how long: a moving line on a terminal, now and then one in a log."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Lock, Thread

from piezoid_cli.terminal import doing, one_line, say

EVERY_s = 10.0  # between lines in a log: a night's work stays readable
STILL_s = 60.0  # after which the same stage is told again, so that a log shows life

# With -v: every stage of the work as it begins, on a terminal too.
EVERYTHING: ContextVar[bool] = ContextVar("EVERYTHING", default=False)


@contextmanager
def shown(*, quiet: bool, every_s: float = EVERY_s) -> Iterator[Callable[[str], None]]:
    """Show progress on standard error: a moving line on a terminal, lines elsewhere.

    every_s  least time between two lines where there is no terminal
    """
    from rich.console import Console

    console = Console(stderr=True, quiet=quiet)
    if quiet:
        yield lambda _: None
    elif EVERYTHING.get():
        yield Log(say_line).begin
    elif console.is_terminal:
        with _bar(console) as told:
            yield told
    else:
        with Log(say_line).kept(every_s) as told:
            yield told


def say_line(line: str) -> None:
    """Write one line of the log."""
    say(line, err=True)


@contextmanager
def _bar(console: object) -> Iterator[Callable[[str], None]]:
    from rich.progress import Progress, SpinnerColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), doing(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:  # type: ignore[arg-type]
        task = progress.add_task("starting", total=None)
        yield lambda text: progress.update(task, description=one_line(text))


class Log:
    """Stages of the work as lines, each with the seconds since the beginning."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """Begin to count.

        write  takes a line
        """
        self._write = write
        self._start_s = time.monotonic()
        self._lock = Lock()
        self._stage = self._written = ""
        self._written_s = 0.0

    def begin(self, stage: str) -> None:
        """Write a stage at once, unless it is the one that was written last."""
        with self._lock:
            self._stage = stage
            self._line(again_s=float("inf"))

    @contextmanager
    def kept(self, every_s: float) -> Iterator[Callable[[str], None]]:
        """Write at most one line in ``every_s``; work that is done by then writes none."""
        ended = Event()

        def write() -> None:
            while not ended.wait(every_s):
                with self._lock:
                    self._line(again_s=STILL_s)

        Thread(target=write, daemon=True).start()
        try:
            yield self._take
        finally:
            ended.set()

    def _take(self, stage: str) -> None:
        with self._lock:
            self._stage = stage

    def _line(self, *, again_s: float) -> None:
        now_s = time.monotonic() - self._start_s
        is_new = self._stage != self._written
        if self._stage and (is_new or now_s - self._written_s >= again_s):
            self._written, self._written_s = self._stage, now_s
            self._write(f"{now_s:5.0f} s  {self._stage}")
