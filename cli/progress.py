"""Progress of the work: a moving line on a terminal, now and then a line in a log."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Event, Lock, Thread

from piezoid_cli.terminal import one_line, say, step_column

INTERVAL_s = 10.0  # between lines in a log: a night's work stays readable
REPEAT_s = 60.0  # after which the line of a long step is repeated, so that a log shows life

# With -v: every step of the work as it begins, on a terminal too.
VERBOSE: ContextVar[bool] = ContextVar("VERBOSE", default=False)


@contextmanager
def show_progress(
    *, quiet: bool, interval_s: float = INTERVAL_s
) -> Iterator[Callable[[str], None]]:
    """Give a function that shows a step of the work on standard error.

    interval_s  shortest time between two lines if there is no terminal
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TimeElapsedColumn

    console = Console(stderr=True, quiet=quiet)
    if quiet:
        yield lambda _: None
    elif VERBOSE.get():
        yield Log(say_line).begin
    elif console.is_terminal:
        columns = (SpinnerColumn(), step_column(), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task("starting", total=None)
            yield lambda text: progress.update(task, description=one_line(text))
    else:
        with Log(say_line).at_intervals(interval_s) as report:
            yield report


def say_line(line: str) -> None:
    """Write one line of the log."""
    say(line, err=True)


class Log:
    """Steps of the work as lines, each with the seconds since the beginning."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """Start the clock; ``write`` takes a line."""
        self._write = write
        self._start_s = time.monotonic()
        self._lock = Lock()
        self._step = self._written = ""
        self._written_s = 0.0

    def begin(self, step: str) -> None:
        """Write a step at once, unless it is the one that was written last."""
        self._set(step)
        self._write_step(repeat_s=float("inf"))

    @contextmanager
    def at_intervals(self, interval_s: float) -> Iterator[Callable[[str], None]]:
        """Give a function that takes a step; write the present step once per interval."""
        ended = Event()

        def write() -> None:
            while not ended.wait(interval_s):
                self._write_step(repeat_s=REPEAT_s)

        Thread(target=write, daemon=True).start()
        try:
            yield self._set
        finally:
            ended.set()

    def _set(self, step: str) -> None:
        with self._lock:
            self._step = step

    def _write_step(self, *, repeat_s: float) -> None:
        with self._lock:
            now_s = time.monotonic() - self._start_s
            is_due = self._step != self._written or now_s - self._written_s >= repeat_s
            if self._step and is_due:
                self._written, self._written_s = self._step, now_s
                self._write(f"{now_s:5.0f} s  {self._step}")
