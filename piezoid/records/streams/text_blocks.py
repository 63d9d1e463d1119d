"""Text tables in blocks: the layout and the headings of the beginning hold to the end."""

import gzip
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import BinaryIO

import numpy as np

from piezoid.records.readers import text_table
from piezoid.records.readers.block import (
    Block,
    lines_are_rows,
)
from piezoid.records.readers.foreign import reading
from piezoid.records.readers.heading_lines import HEAD_LINES, Start, find_start, names_but_first
from piezoid.records.readers.source import (
    Source,
    check_growth,
    encoding_of,
    unreadable,
    with_hyphens,
)
from piezoid.records.recording import Problem
from piezoid.records.streams.format import BlockFormat
from piezoid.records.table import RawTable

_LONGEST_LINE = 1 << 20  # characters; 4096 columns of whole doubles have a tenth of it
_LONGEST_HEAD = 1 << 24


def blocks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield a text table block by block, of about so many rows each.

    Columns that hold text at the beginning are left out throughout; others that come to hold none
    but text are NaN there.
    """
    with _text(source) as stream:
        start = _start(stream, source)
        first: Block | None = None
        line, ahead = start.row + 1, 0
        for text in _pieces(stream, rows, source.name):
            block, begins, told = text_table.parsed(text, start, source.name, line)
            _refuse_dates(block, source.name, line)
            if first is None:
                start, first = _settled(start, block), block
            beside = _beside(start, block) if first is block else ()
            yield RawTable(
                name=source.name,
                digest=source.digest,
                format="text table",
                columns=text_table.columns_of(start, _like(first, block)),
                first_line=line if lines_are_rows(text) and not begins else 0,
                segment_starts=begins,
                first_row=ahead,
                metadata=text_table.metadata_of(start.above),
                problems=(*beside, *told, *block.problems),
            )
            line += text.rstrip("\n").count("\n")
            ahead += len(block.columns[0]) - 1


@contextmanager
def _text(source: Source) -> Iterator[io.TextIOWrapper]:
    """Open the text as ``text_of`` decodes it, as far as the file's beginning tells."""
    with reading(source, "text"), source.path.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
        raw.seek(0)
        stream = io.BufferedReader(_Unpacked(source, raw)) if packed else raw
        yield io.TextIOWrapper(stream, encoding=encoding_of(source.head), errors="replace")


class _Unpacked(gzip.GzipFile):
    """What an archive holds, up to where it can be no measurement any more."""

    def __init__(self, source: Source, packed: BinaryIO) -> None:
        super().__init__(fileobj=packed)
        self._source = source

    def read(self, size: int | None = -1) -> bytes:
        content = super().read(size)
        check_growth(self._source, self.tell(), whole=False)
        return content


def _start(stream: io.TextIOWrapper, source: Source) -> Start:
    """Find the table, and leave the stream at its first row."""
    lines: list[str] = []
    while len(lines) < HEAD_LINES and sum(map(len, lines)) < _LONGEST_HEAD:
        line = stream.readline(_LONGEST_LINE)
        if not line:
            break
        lines.append(line.removesuffix("\n"))
    start = find_start(lines, source.name, source.text)
    stream.seek(0)
    for _ in range(start.row):
        stream.readline()
    return start


def _pieces(stream: io.TextIOWrapper, rows: int, name: str) -> Iterator[str]:
    """Yield whole lines of about so many rows; each piece repeats the last line before.

    A short rest goes with the piece in front of it.
    """
    held = stream.readline(_LONGEST_LINE)
    characters = max(rows, 2) * len(held)
    held += _lines(stream, characters, name)
    while held:
        more = _lines(stream, characters, name)
        if len(more) < characters:
            yield held + more
            return
        yield held
        held = _last_line(held) + more


def _lines(stream: io.TextIOWrapper, characters: int, name: str) -> str:
    rest = ""
    text = stream.read(characters)
    if text and not text.endswith("\n"):
        rest = stream.readline(_LONGEST_LINE)
    if "\x00" in text or len(rest) >= _LONGEST_LINE:
        raise unreadable(
            name,
            "it holds zero bytes, or a line of more than a million characters",
            needed="a text table to its end",
            remedy="Export the recording as CSV.",
        )
    return with_hyphens(text + rest)


def _last_line(text: str) -> str:
    lines = text.rstrip("\n")
    return lines[lines.rfind("\n") + 1 :] + "\n"


def _settled(start: Start, block: Block) -> Start:
    """Return the headings, once it is seen whether the first column counts the rows."""
    named = names_but_first(start)
    if named is None or not text_table.are_row_numbers(block.columns[0]):
        return start
    return replace(start, labels=named, above=start.above[:-1])


def _beside(start: Start, block: Block) -> tuple[Problem, ...]:
    return (*text_table.stray_problems(start), *text_table.textual_problems(start, block))


def _like(first: Block, block: Block) -> Block:
    """Return a block whose columns of text are those of the first block."""
    columns = tuple(
        np.full_like(values, np.nan) if k in block.textual else values
        for k, values in enumerate(block.columns)
    )
    return replace(block, columns=columns, textual=first.textual)


def _refuse_dates(block: Block, name: str, line: int) -> None:
    if block.stamped:
        raise unreadable(
            name,
            f"column {min(block.stamped) + 1} holds dates from line {line} on",
            needed="times in seconds, where a file is read in blocks",
            remedy="Write the time as seconds, or state sampling_rate_Hz for the file in lab.toml "
            "and name its other columns there.",
            line=line,
        )


FORMAT = BlockFormat(reader=text_table.READER, blocks=blocks, unpacks=True)
