r"""Output on the terminal: text, tables, statements and progress.

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
from textwrap import fill
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from piezoid.errors import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.table import Table
    from rich.text import Text

    from piezoid.diagnosis.diagnosis import Diagnosis
    from piezoid.statement import Level, Statement
    from piezoid_reports.parts import Table as ReportTable

NARROW, MINUS = "\u202f", "\u2212"  # typography of the report
MAX_SHOWN = 5  # statements
INDENT = "  "
INTERVAL_s = 10.0  # between lines in a log
REPEAT_s = 60.0  # after which the line of a long step is repeated

# With -v: print each step when it starts, also on a terminal.
VERBOSE: ContextVar[bool] = ContextVar("VERBOSE", default=False)

Quiet = Annotated[bool, typer.Option("--quiet", help="Print only errors.")]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace earlier results in --out, also files that you edited."),
]
ForceEdited = Annotated[
    bool,
    typer.Option(
        "--force", help="Also replace files that you edited; unedited files are always replaced."
    ),
]
StageLab = Annotated[Path | None, typer.Option(help="lab.toml; default: in the stage folder.")]
RecordingLab = Annotated[
    Path | None, typer.Option("--lab", help="lab.toml: rig, columns and units.")
]
Processes = Annotated[
    int | None, typer.Option(help="Number of worker processes; default: one per core.", min=1)
]
Json = Annotated[bool, typer.Option("--json", help="For scripts: print a JSON summary.")]
JsonFile = Annotated[bool, typer.Option("--json", help="For scripts: print the JSON file.")]


class StandardStream(io.RawIOBase):
    """Standard output or error that may be closed while a command runs, or be on a full disk.

    If the reader of a pipe has closed it, further output is discarded and the command continues.
    Other failures raise ``OSError`` with the name of the stream, or are ignored without a name.
    """

    def __init__(self, stream: io.RawIOBase | io.BufferedIOBase, name: str = "") -> None:
        """Write to a binary stream with a name for errors."""
        self._stream, self._name = stream, name
        self.is_discarded = False

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._stream.fileno()

    def write(self, content: Any, /) -> int:
        """Write bytes and return their number."""
        size = len(memoryview(content).cast("B"))
        try:
            if not self.is_discarded:
                self._stream.write(content)
                self._stream.flush()
        except BrokenPipeError:
            self.is_discarded = True
        except OSError as error:
            self.is_discarded = True
            if self._name:
                raise OSError(error.errno, error.strerror, self._name) from error
        return size


def guard_output() -> None:
    """Protect the command against closed streams and encodings that lack characters."""
    sys.stdout = _guarded(sys.stdout, "standard output")
    sys.stderr = _guarded(sys.stderr)


def _guarded(stream: TextIO | None, name: str = "") -> TextIO:
    if stream is None:  # closed before the command started
        return Path(os.devnull).open("w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    encoding, buffered = stream.encoding, stream.line_buffering
    binary = io.BufferedWriter(StandardStream(stream.detach(), name))
    return io.TextIOWrapper(
        binary, encoding, errors="replace", line_buffering=buffered, write_through=True
    )


def say(text: str, *, err: bool = False) -> None:
    """Print one line without wrapping, so that a path in it can be copied."""
    typer.echo(printable(text), err=err)


def rich_text(text: str, style: str = "") -> "Text":
    """Return text of one or more lines for a console, without markup and control characters."""
    from rich.text import Text

    return Text(printable(text, keep="\n"), style)


def table(
    title: str, headings: "Sequence[str]", rows: "Iterable[Sequence[str | Text]]", n_words: int = 0
) -> "Table":
    """Return a table with cells that are shown as text.

    n_words  number of leading columns with words; the others are right-aligned numbers
    """
    from rich.table import Table

    cells = Table(title=rich_text(title))
    for k, heading in enumerate(headings):
        cells.add_column(heading, justify="left" if k < n_words else "right")
    for row in rows:
        cells.add_row(*(rich_text(cell) if isinstance(cell, str) else cell for cell in row))
    return cells


def report_table(part: "ReportTable", title: str = "") -> "Table":
    """Return a table of the report for a console; default title: that of the report."""
    plain = str.maketrans({NARROW: " ", MINUS: "-"})
    rows = ([cell.translate(plain) for cell in row] for row in part.rows)
    return table(title or part.summary, part.columns, rows, n_words=len(part.columns))


def print_raw(content: str | bytes) -> None:
    """Print output for a script, byte for byte."""
    typer.echo(content, nl=isinstance(content, str))


def print_record(schema: str, **entries: object) -> None:
    """Print the result of a verb as JSON, under a schema such as ``exported``."""
    from json import dumps

    print_raw(dumps({"schema": f"piezoid.{schema}/1", **entries}, indent=1, allow_nan=False))


def show_statements(statements: "Iterable[Statement]", minimum: "Level | None" = None) -> None:
    """Print at most five statements at or above a level (default: action), or all with -v."""
    from rich.console import Console

    from piezoid.statement import Level, select

    is_verbose = VERBOSE.get()
    lowest = Level.NOTE if is_verbose else Level.ACTION if minimum is None else minimum
    selected = select(statements, minimum=lowest)
    listed = selected if is_verbose else selected[:MAX_SHOWN]
    console = Console()
    if listed and lowest is Level.ACTION:
        console.print(rich_text("needs action:"))
    for statement in listed:
        axis = f"axis {statement.axis}: " if statement.axis else ""
        style = {Level.ACTION: "bold", Level.NOTE: "dim"}.get(statement.level, "")
        text = fill(
            f"{axis}{statement.text}",
            width=console.width,
            initial_indent=INDENT,
            subsequent_indent=INDENT,
        )
        console.print(rich_text(text, style=style))
    if len(selected) > len(listed):
        omitted = len(selected) - len(listed)
        console.print(rich_text(f"  {omitted} more in the report and with --verbose"))


def budget_lines(diagnoses: "Sequence[Diagnosis]") -> list[str]:
    """Return the error budget of each diagnosed axis as a line, followed by a legend."""
    from piezoid.formatting import with_unit
    from piezoid.raw_counts import in_counts
    from piezoid_reports.sections.error_budget import label_of, visible_parts

    lines = []
    for diagnosis in diagnoses:
        terms = ", ".join(
            f"{label_of(part.part)} {with_unit(part.rms_m, 'm')}{'*' if part.is_explained else ''}"
            for part in visible_parts(diagnosis)
        )
        total = with_unit(diagnosis.baseline.rms_m, "m")
        name = "simulation" if diagnosis.model is None else "base model"
        line = f"error budget {diagnosis.axis}: {name} {total}, from {terms}"
        lines.append(in_counts(line, diagnosis.counted))
    if any("*" in line for line in lines):
        lines.append(
            "(budget: held-out rms; squares add up; base model: hysteresis alone; the final model "
            "removes the parts with *, the others make up its error)"
        )
    return lines


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
