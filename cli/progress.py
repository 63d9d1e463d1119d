"""Progress display: an animated line on a terminal, or lines at intervals in a log."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from threading import Event, Lock, Thread

from piezoid_cli.terminal import one_line, say, step_column

INTERVAL_s = 10.0  # between lines in a log
REPEAT_s = 60.0  # after which the line of a long step is repeated

# With -v: print each step when it starts, also on a terminal.
VERBOSE: ContextVar[bool] = ContextVar("VERBOSE", default=False)


@contextmanager
def show_progress(
    *, quiet: bool, interval_s: float = INTERVAL_s
) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the current step on standard error.

    interval_s  minimum time between two lines without a terminal
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TimeElapsedColumn

    console, write = Console(stderr=True, quiet=quiet), partial(say, err=True)
    if quiet:
        yield lambda _: None
    elif VERBOSE.get():
        yield Log(write).begin
    elif console.is_terminal:
        columns = (SpinnerColumn(), step_column(), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task("starting", total=None)
            yield lambda text: progress.update(task, description=one_line(text))
    else:
        with Log(write).at_intervals(interval_s) as report:
            yield report


class Log:
    """Log of the steps, one line each with the elapsed seconds."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """Start the clock; ``write`` receives each line."""
        self._write = write
        self._start_s = time.monotonic()
        self._lock = Lock()
        self._step = self._written = ""
        self._written_s = 0.0

    def begin(self, step: str) -> None:
        """Write a step at once, unless the latest line already shows it."""
        self._set(step)
        self._write_step(repeat_s=float("inf"))

    @contextmanager
    def at_intervals(self, interval_s: float) -> Iterator[Callable[[str], None]]:
        """Yield a function that sets the current step, which is written once per interval."""
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
