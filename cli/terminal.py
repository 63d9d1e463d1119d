r"""Output on the terminal, safe against control characters in names from files.

A heading or the name of a file may contain codes that clear a terminal, move its cursor or set its
title. All text output is printed by this module, with such characters escaped (``\x1b``). Output
for scripts (``--json``) is printed byte for byte.
"""

import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from piezoid.errors import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.progress import TextColumn
    from rich.table import Table
    from rich.text import Text

    from piezoid_reports.parts import Table as ReportTable

NARROW, MINUS = "\u202f", "\u2212"  # typography of the report
Quiet = Annotated[bool, typer.Option("--quiet", help="Print only errors.")]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace files that piezoid wrote, including edited files."),
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


def step_column() -> "TextColumn":
    """Return the column of a progress bar that shows the current step."""
    from rich.progress import TextColumn

    return TextColumn("{task.description}", markup=False)
