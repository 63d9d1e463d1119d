"""Progress display: an animated line on a terminal, or lines at intervals in a log."""

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from threading import Event, Thread

from piezoid.errors import printable
from piezoid_cli.terminal import say, step_column

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

    console, log = Console(stderr=True, quiet=quiet), Log(partial(say, err=True))
    if quiet:
        yield lambda _: None
    elif VERBOSE.get():
        yield log.write
    elif console.is_terminal:
        columns = (SpinnerColumn(), step_column(), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task("starting", total=None)
            yield lambda text: progress.update(task, description=printable(text))
    else:
        with log.at_intervals(interval_s) as report:
            yield report


class Log:
    """Log of the steps, one line each with the elapsed seconds."""

    def __init__(self, print_line: Callable[[str], None]) -> None:
        """Start the clock; ``print_line`` receives each line."""
        self._print_line = print_line
        self._start_s = self._printed_s = time.monotonic()
        self._latest = ""

    def write(self, step: str, *, repeat_s: float = float("inf")) -> None:
        """Write a step, unless the latest line shows it and is younger than ``repeat_s``."""
        now_s = time.monotonic()
        if step and (step != self._latest or now_s - self._printed_s >= repeat_s):
            self._latest, self._printed_s = step, now_s
            self._print_line(f"{now_s - self._start_s:5.0f} s  {step}")

    @contextmanager
    def at_intervals(self, interval_s: float) -> Iterator[Callable[[str], None]]:
        """Yield a function that sets the current step, which is written once per interval."""
        ended, steps = Event(), deque([""], maxlen=1)

        def write() -> None:
            while not ended.wait(interval_s):
                self.write(steps[-1], repeat_s=REPEAT_s)

        Thread(target=write, daemon=True).start()
        try:
            yield steps.append
        finally:
            ended.set()
