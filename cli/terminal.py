r"""Output on the terminal: text, JSON and progress.

A heading or the name of a file may contain codes that clear a terminal, move its cursor or set its
title. All text output is printed by this module, with such characters escaped (``\x1b``). Output
for scripts (``--json``) is printed byte for byte.
"""

import io
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, TextIO

import typer

from piezoid.errors import printable

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text


INTERVAL_s = 10.0  # between lines in a log
REPEAT_s = 60.0  # after which the line of a long step is repeated

# With -v: print each step when it starts, also on a terminal.
VERBOSE: ContextVar[bool] = ContextVar("VERBOSE", default=False)


class StandardStream(io.FileIO):
    """Standard output or error that may be closed while a command runs, or be on a full disk.

    If the reader of a pipe has closed it, further output is discarded and the command continues.
    Other failures raise ``OSError`` with the title of the stream, or are ignored without a title.
    """

    def __init__(self, number: int, title: str = "") -> None:
        """Write to a file descriptor; the title names the stream in errors."""
        super().__init__(number, "w", closefd=False)
        self._title, self._is_discarded = title, False

    def write(self, content: Any, /) -> int:
        """Write bytes and return their number."""
        try:
            if not self._is_discarded:
                return super().write(content)
        except OSError as error:
            self._is_discarded = True
            if self._title and not isinstance(error, BrokenPipeError):
                raise OSError(error.errno, error.strerror, self._title) from error
        return len(memoryview(content).cast("B"))


def guard_output() -> None:
    """Protect the command against closed streams and encodings that lack characters."""
    sys.stdout = _guarded(sys.stdout, "standard output")
    sys.stderr = _guarded(sys.stderr)


def _guarded(stream: TextIO | None, title: str = "") -> TextIO:
    if stream is None:  # closed before the command started
        return Path(os.devnull).open("w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    try:
        binary = io.BufferedWriter(StandardStream(stream.fileno(), title))
    except io.UnsupportedOperation:  # in memory
        return stream
    stream.flush()
    return io.TextIOWrapper(
        binary,
        stream.encoding,
        errors="replace",
        line_buffering=stream.line_buffering,
        write_through=True,
    )


def say(text: str, *, err: bool = False) -> None:
    """Print one line without wrapping, so that a path in it can be copied."""
    typer.echo(printable(text), err=err)


def rich_text(text: str, style: str = "") -> "Text":
    """Return text of one or more lines for a console, without markup and control characters."""
    from rich.text import Text

    return Text(printable(text, keep="\n"), style)


def display(part: "str | Table", style: str = "") -> None:
    """Print a table, or text that is wrapped at the width of the terminal."""
    from rich.console import Console

    Console().print(rich_text(part, style) if isinstance(part, str) else part)


def print_raw(content: str | bytes) -> None:
    """Print output for a script, byte for byte."""
    typer.echo(content, nl=isinstance(content, str))


def print_record(schema: str, **entries: object) -> None:
    """Print the result of a verb as JSON, under a schema such as ``exported``."""
    from json import dumps

    print_raw(dumps({"schema": f"piezoid.{schema}/1", **entries}, indent=1, allow_nan=False))


@contextmanager
def show_progress(
    *, quiet: bool, interval_s: float = INTERVAL_s
) -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the current step on standard error.

    interval_s  minimum time between two lines without a terminal
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console, log = Console(stderr=True, quiet=quiet), Log(partial(say, err=True))
    if quiet:
        yield lambda _: None
    elif VERBOSE.get():
        yield log.write
    elif console.is_terminal:
        step = TextColumn("{task.description}", markup=False)
        columns = (SpinnerColumn(), step, TimeElapsedColumn())
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
