r"""The terminal: names from files are shown there as text, whatever they hold.

A terminal obeys what a heading or a file's name may contain: codes that clear it, move the cursor,
set its title, turn the text. Whatever people read is made here, with such characters as codes
(``\x1b``); only what scripts read (``--json``) goes past, byte for byte.
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
    """Standard output or error that may be closed while a command works, or lie on a full disk.

    Nothing more is written once the reader of a pipe has gone: the command does its work all the
    same. Any other failure names standard output; of standard error nothing can be said.
    """

    def __init__(self, stream: io.RawIOBase | io.BufferedIOBase, name: str = "") -> None:
        """Write to a binary stream.

        name  in the error about a write that fails; without one there is no error
        """
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
    """Let no stream that is closed and no terminal of few characters end a command."""
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
    """Print one line, never broken by us: a path in it can be copied."""
    typer.echo(one_line(text), err=err)


def one_line(text: str) -> str:
    """Return a text without anything that a terminal obeys, a line's end included."""
    return str(printable(text))


def plain(text: str, style: str = "") -> "Text":
    """Return a cell or a paragraph, its lines kept: no markup, nothing that a terminal obeys."""
    from rich.text import Text

    return Text("\n".join(one_line(line) for line in text.split("\n")), style)


def table(
    title: str, headings: "Sequence[str]", rows: "Iterable[Sequence[str | Text]]", left: int = 0
) -> "Table":
    """Return a table of cells that are shown as text.

    left  how many columns, from the first on, hold words; the others are numbers, to the right
    """
    from rich.table import Table

    cells = Table(title=plain(title))
    for k, heading in enumerate(headings):
        cells.add_column(heading, justify="left" if k < left else "right")
    for row in rows:
        cells.add_row(*(plain(cell) if isinstance(cell, str) else cell for cell in row))
    return cells


def hand_over(content: str | bytes) -> None:
    """Print what a script reads, as it is."""
    typer.echo(content, nl=isinstance(content, str))


def hand_over_record(schema: str, **entries: object) -> None:
    """Print the result of a verb as JSON, under a schema such as ``exported``."""
    from json import dumps

    hand_over(dumps({"schema": f"piezoid.{schema}/1", **entries}, indent=1, allow_nan=False))


def doing() -> "TextColumn":
    """Return the column of a progress bar that says what is being done."""
    from rich.progress import TextColumn

    return TextColumn("{task.description}", markup=False)
