r"""Output on the terminal: names from files are shown as text, whatever they contain.

A heading or the name of a file may contain codes that a terminal executes: they clear it, move the
cursor, set its title. Everything that people read is printed here, with such characters as codes
(``\x1b``); what scripts read (``--json``) is printed byte for byte.
"""

import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from piezoid_reports.plain_text import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.progress import TextColumn
    from rich.table import Table
    from rich.text import Text

Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]
Force = Annotated[
    bool,
    typer.Option("--force", help="Replace files that piezoid wrote there, edited ones as well."),
]
StageLab = Annotated[Path | None, typer.Option(help="lab.toml; by default the one in the folder.")]
RecordingLab = Annotated[
    Path | None, typer.Option("--lab", help="lab.toml: rig, columns and units.")
]
Processes = Annotated[
    int | None, typer.Option(help="Number of worker processes; default: one per core.", min=1)
]
Json = Annotated[bool, typer.Option("--json", help="For scripts: one JSON text.")]
JsonFile = Annotated[
    bool, typer.Option("--json", help="For scripts: print the written JSON file itself.")
]


class StandardStream(io.RawIOBase):
    """Standard output or error that may be closed while a command works, or be on a full disk.

    If the reader of a pipe has gone, nothing more is written and the command goes on. Any other
    failure is an error with the name of the stream, if it has one.
    """

    def __init__(self, stream: io.RawIOBase | io.BufferedIOBase, name: str = "") -> None:
        """Write to a binary stream; ``name`` it in errors, or ignore them without a name."""
        self._stream, self._name = stream, name
        self.is_discarded = False

    def writable(self) -> bool:
        """Return True."""
        return True

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return its number in this process."""
        return self._stream.fileno()

    def write(self, content: Any, /) -> int:
        """Write bytes and return how many."""
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
    """Let no closed stream and no encoding of few characters end a command."""
    sys.stdout = _guarded(sys.stdout, "standard output")
    sys.stderr = _guarded(sys.stderr)


def _guarded(stream: TextIO | None, name: str = "") -> TextIO:
    if stream is None:  # it was closed before the command began
        return Path(os.devnull).open("w", encoding="utf-8")
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    encoding, buffered = stream.encoding, stream.line_buffering
    binary = io.BufferedWriter(StandardStream(stream.detach(), name))
    return io.TextIOWrapper(
        binary, encoding, errors="replace", line_buffering=buffered, write_through=True
    )


def say(text: str, *, err: bool = False) -> None:
    """Print one line without breaking it, so that a path in it can be copied."""
    typer.echo(one_line(text), err=err)


def one_line(text: str) -> str:
    """Return a text without control characters, line ends included."""
    return str(printable(text))


def plain(text: str, style: str = "") -> "Text":
    """Return a text of one or more lines without markup and control characters."""
    from rich.text import Text

    return Text("\n".join(one_line(line) for line in text.split("\n")), style)


def table(
    title: str, headings: "Sequence[str]", rows: "Iterable[Sequence[str | Text]]", n_words: int = 0
) -> "Table":
    """Return a table of cells that are shown as text.

    n_words  number of leading columns with words; the others are numbers, aligned to the right
    """
    from rich.table import Table

    cells = Table(title=plain(title))
    for k, heading in enumerate(headings):
        cells.add_column(heading, justify="left" if k < n_words else "right")
    for row in rows:
        cells.add_row(*(plain(cell) if isinstance(cell, str) else cell for cell in row))
    return cells


def print_raw(content: str | bytes) -> None:
    """Print the output for a script, byte for byte."""
    typer.echo(content, nl=isinstance(content, str))


def print_record(schema: str, **entries: object) -> None:
    """Print the result of a verb as JSON, under a schema such as ``exported``."""
    from json import dumps

    print_raw(dumps({"schema": f"piezoid.{schema}/1", **entries}, indent=1, allow_nan=False))


def step_column() -> "TextColumn":
    """Return the column of a progress bar that shows the step of the work."""
    from rich.progress import TextColumn

    return TextColumn("{task.description}", markup=False)
