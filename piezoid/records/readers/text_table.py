"""Text tables: CSV, TSV, semicolons or blanks, decimal point or comma, with lines above.

Cells may hold complex numbers: ``0.2-0.03i``, ``(0.2-0.03j)``, ``0.2+-0.03j``.
"""

import gzip
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from piezoid.records.readers.named_arrays import complex_statement
from piezoid.records.readers.reader import (
    FREE_SIZE,
    Reader,
    Source,
    check_growth,
    encoding_of,
    refuse_zero_bytes,
    text_of,
    unreadable,
    with_hyphens,
)
from piezoid.records.readers.text_layout import (
    HEAD_LINES,
    UNIT_BRACKETS,
    TableStart,
    drop_repeated_headings,
    find_table,
    with_headings_beside_row_numbers,
)
from piezoid.records.readers.text_numbers import (
    Layout,
    NumberTable,
    parse_numbers,
    without_comments,
)
from piezoid.records.table import Column, RawTable
from piezoid.statement import finding

TESTED_LINES = 10  # at the end of the head, below comments and headings


# Possessive quantifiers (++): a run of digits is searched once. A comma marks decimals only if the
# fields have another separator. The sign has white space on both sides or on neither:
# "1.0 -0.3i" are two fields.
_WITH_POINTS, _WITH_COMMAS = (
    re.compile(
        rf"(?<![\w.])\(?(?P<real>[+-]?{digits})(?:\s{{1,9}}(?P<spaced>[+-])\s{{1,9}}|\+?(?P<sign>[+-]))"
        rf"(?P<imaginary>{digits})\s?\*?[ijIJ](?![a-zA-Z\d])\)?"
    )
    for digits in (
        r"(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?",
        r"(?:\d++(?:[.,]\d*+)?|[.,]\d++)(?:[eE][+-]?\d++)?",
    )
)
# Lines without a zero byte. Binary formats with longer headers of text have their own readers.
MIN_TEXT_LINES = 3
_MAX_ZEROS = 0.05  # of the first bytes
_CONTROLS = frozenset(range(1, 32)) - frozenset(b"\t\n\v\f\r\x1a")
MAX_LINE = 1 << 20  # characters; 4096 columns of whole doubles have a tenth of it
MAX_HEAD = 1 << 24


def read_text(source: Source, text: str) -> RawTable:
    """Read the columns of numbers of the text of a table.

    A complex column becomes two columns, named like those of MATLAB files.
    """
    head = [line for line in text.split("\n", HEAD_LINES)[:HEAD_LINES] if line.strip()]
    tested = head[-TESTED_LINES:]
    pattern = _WITH_COMMAS if tested and {";", "\t"} & set(tested[-1]) else _WITH_POINTS
    if not tested or not all(map(pattern.search, tested[1:] or tested)):
        return _read_numbers(source, text)
    # Only one of the two groups of the sign matches.
    parts = (r"\g<real>", r"\g<spaced>\g<sign>\g<imaginary>")
    real, imaginary = (_read_numbers(source, pattern.sub(part, text)) for part in parts)
    columns: list[Column] = []
    complex_columns: list[Column] = []
    for column, imaginary_column in zip(real.columns, imaginary.columns, strict=True):
        pieces = [column]
        if not np.array_equal(column.values, imaginary_column.values, equal_nan=True):
            complex_columns.append(column)
            label = column.label or str(column.number)
            pieces = [
                replace(column, label=f"real({label})"),
                replace(imaginary_column, label=f"imag({label})"),
            ]
        columns += [replace(piece, number=len(columns) + k + 1) for k, piece in enumerate(pieces)]
    if not complex_columns:
        return real
    locations = ", ".join(column.place for column in complex_columns[:3])
    suffix = ", ..." if len(complex_columns) > 3 else ""
    statement = complex_statement(f"{locations}{suffix}", complex_columns[0].place)
    return replace(real, columns=tuple(columns), statements=(*real.statements, statement))


def _read_numbers(source: Source, text: str) -> RawTable:
    """Read a table of real numbers."""
    start = find_table(text.split("\n", HEAD_LINES)[:HEAD_LINES], source.name, source.text)
    body = text.split("\n", start.row)[-1] if start.row else text
    return next(_tables(source, start, [body]))


def read_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield a text table in chunks; layout and headings are those of the file's beginning."""
    with source.path.open("rb") as raw:
        packed: Any = gzip.GzipFile(fileobj=raw) if source.is_gzip else raw
        # ``text_of`` decodes in the same way, except for errors behind the file's beginning.
        stream = io.TextIOWrapper(packed, encoding=encoding_of(source.head), errors="replace")
        lines: list[str] = []
        while len(lines) < HEAD_LINES and sum(map(len, lines)) < MAX_HEAD:
            head_line = stream.readline(MAX_LINE)
            if not head_line:
                break
            lines.append(head_line.removesuffix("\n"))
        start = find_table(lines, source.name, source.text)
        stream.seek(0)
        for _ in range(start.row):
            stream.readline()
        yield from _tables(source, start, _line_chunks(stream, rows, source))


def _tables(source: Source, start: TableStart, bodies: Iterable[str]) -> Iterator[RawTable]:
    """Yield the columns of numbers of a text in one or more parts, each under its heading.

    Columns of text in the first part are left out throughout; other columns are NaN in parts in
    which they hold only text.
    """
    textual: frozenset[int] | None = None
    line = start.row + 1
    for body in bodies:
        block, segment_starts = parse_rows(body, start, source.name, line)
        statements = list(block.statements)
        if block.stamped and not source.in_memory:
            raise unreadable(
                source.name,
                f"column {min(block.stamped) + 1} holds dates from line {line} on",
                needed="times in seconds, if a file is read in chunks",
                remedy="Write the time as seconds, or state sampling_rate_Hz for the file in "
                "lab.toml and name its other columns there.",
                line=line,
            )
        if textual is None:
            start = with_headings_beside_row_numbers(start, block.columns[0])
            textual = block.textual
            if start.strays:
                text = (
                    f"{len(start.strays)} lines above the table hold numbers, but not "
                    f"{start.layout.fields} of them; they are not read"
                )
                location = f"line {start.strays[0]}"
                statements.append(finding("rows_above", text, place=location))
            for k in sorted(block.textual):
                text = f"column {k + 1} {start.labels[k]!r} holds text and is not read"
                statements.append(finding("text_column", text, place=f"column {k + 1}"))
        columns = tuple(
            Column(
                number=k + 1,
                label=start.labels[k],
                declared_unit="s" if k in block.stamped else start.units[k].strip(UNIT_BRACKETS),
                values=np.full_like(values, np.nan) if k in block.textual else values,
            )
            for k, values in enumerate(block.columns)
            if k not in textual
        )
        has_other_lines = "\n\n" in body.rstrip("\n") or bool(without_comments(body, line)[1])
        yield RawTable(
            columns=columns,
            # With other lines between the rows the line of a row is unknown.
            first_line=0 if has_other_lines or segment_starts else line,
            segment_starts=segment_starts,
            metadata=metadata_of(start.above),
            statements=tuple(statements),
        )
        line += body.count("\n")


def table_under(
    source: Source, headings: Sequence[tuple[str, str]], body: str, layout: Layout, line: int
) -> RawTable:
    """Read rows under headings from the format of an instrument.

    headings  label and unit of the first columns; further columns are not read
    line      of the first row
    """
    block = parse_numbers(body, layout, source.name, line)
    columns = tuple(
        Column(number=k + 1, label=label, declared_unit=unit, values=values)
        for k, ((label, unit), values) in enumerate(zip(headings, block.columns, strict=False))
    )
    return RawTable(columns=columns, first_line=line, statements=block.statements)


def parse_rows(
    body: str, start: TableStart, name: str, line: int
) -> tuple[NumberTable, tuple[int, ...]]:
    """Return the numbers of a table, without comments and headings among its rows.

    line      of the first row
    returned  block, with statements about removed lines; first rows behind each repeated heading

    Raises ``UnreadableFileError`` for other headings among the rows, which change the meaning of
    the columns.
    """
    rows, remarks = without_comments(body, line)
    block = parse_numbers(rows, start.layout, name, line)
    if not remarks and all(s.quantity != "not_a_number" for s in block.statements):
        return block, ()
    body, segment_starts, heading_lines = drop_repeated_headings(body, start, name, line)
    if heading_lines:
        rows, remarks = without_comments(body, line)
        text = (
            f"the headings are repeated at {len(heading_lines)} places, as in a file of several "
            "runs: each has a separate initial state"
        )
        location = f"line {heading_lines[0]}"
        remarks = (*remarks, finding("repeated_heading", text, place=location))
        block = parse_numbers(rows, start.layout, name, line)
    return replace(block, statements=(*remarks, *block.statements)), segment_starts


def metadata_of(lines: Sequence[str]) -> dict[str, str]:
    """Return ``key: value``, ``key = value`` or ``key, value`` lines as pairs."""
    metadata = {}
    for line in lines:
        content = line.strip().lstrip("#%/ ")
        parts = re.split(r"[\t=:;,]", content, maxsplit=1)
        if len(parts) == 2 and parts[0].strip():
            key, value = (part.strip().strip('"') for part in parts)
            metadata[key] = value
    return metadata


def _line_chunks(stream: "io.TextIOWrapper[Any]", rows: int, source: Source) -> Iterator[str]:
    """Yield whole lines of about ``rows`` rows; a short remainder belongs to the last chunk."""
    text = stream.readline(MAX_LINE)
    characters = min(rows * len(text), FREE_SIZE)
    text += _whole_lines(stream, characters, source)
    while text:
        next_text = _whole_lines(stream, characters, source)
        if len(next_text) < characters:
            yield text + next_text
            return
        yield text
        text = next_text


def _whole_lines(stream: "io.TextIOWrapper[Any]", characters: int, source: Source) -> str:
    text, end_of_line = stream.read(characters), ""
    check_growth(source, stream.buffer.tell())
    if text and not text.endswith("\n"):
        end_of_line = stream.readline(MAX_LINE)
    if "\x00" in text:
        refuse_zero_bytes(source)
    if len(end_of_line) >= MAX_LINE:
        raise unreadable(
            source.name,
            "it holds a line of more than a million characters",
            needed="a text table to its end",
            remedy="Export the recording as CSV.",
        )
    return with_hyphens(text + end_of_line)


def recognises(source: Source) -> bool:
    """Recognise any text; it may contain some zero bytes, which ``text_of`` refuses as damage."""
    head = source.head
    before_zero = head.partition(b"\x00")[0]
    return (
        before_zero == head
        or before_zero.count(b"\n") >= MIN_TEXT_LINES
        or encoding_of(head).startswith("utf-16")
        or (head.count(b"\x00") < _MAX_ZEROS * len(head) and not _CONTROLS.intersection(head))
    )


READER = Reader(
    name="text table",
    usual_suffixes=(".csv", ".tsv", ".txt", ".dat", ".asc"),
    recognises=recognises,
    read=lambda source: read_text(source, text_of(source)),
    read_chunks=read_chunks,
    has_text_layout=True,
)
