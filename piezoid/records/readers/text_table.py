"""Text tables: CSV, TSV, semicolons or blanks, decimal point or comma, with whatever is above."""

from dataclasses import replace

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.readers.block import (
    Block,
    lines_are_rows,
    parse_block,
    without_comments,
)
from piezoid.records.readers.complex_cells import joined, parts_of
from piezoid.records.readers.heading_lines import (
    HEAD_LINES,
    Start,
    find_start,
    names_but_first,
    unit_cell,
    without_headings,
)
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, encoding_of, text_of
from piezoid.records.recording import Problem
from piezoid.records.table import Column, RawTable

# No binary format begins with so many lines without a zero byte, unless it has a header of text:
# those that are known here are asked before.
_LINES_OF_TEXT = 3


def read(source: Source) -> RawTable:
    """Read a text table; columns of text are left out, their place stays counted."""
    return read_text(source, text_of(source), "text table")


def read_text(source: Source, text: str, format_name: str) -> RawTable:
    """Read the text of a table, whatever file it came in."""
    parts = parts_of(text)
    if parts is None:
        return _read_numbers(source, text, format_name)
    return joined(*(_read_numbers(source, part, format_name) for part in parts))


def _read_numbers(source: Source, text: str, format_name: str) -> RawTable:
    """Read a table of real numbers."""
    start = find_start(text.split("\n", HEAD_LINES)[:HEAD_LINES], source.name, source.text)
    body = text.split("\n", start.row)[-1] if start.row else text
    block, begins, told = parsed(body, start, source.name, start.row + 1)
    named = names_but_first(start)
    if named is not None and are_row_numbers(block.columns[0]):
        start = replace(start, labels=named, above=start.above[:-1])
    return RawTable(
        name=source.name,
        digest=source.digest,
        format=format_name,
        columns=columns_of(start, block),
        # With other lines between the rows a row's line is not known; its number still is.
        first_line=start.row + 1 if lines_are_rows(body) and not begins else 0,
        segment_starts=begins,
        metadata=metadata_of(start.above),
        problems=(
            *stray_problems(start),
            *told,
            *block.problems,
            *textual_problems(start, block),
        ),
    )


def parsed(
    body: str, start: Start, name: str, line: int
) -> tuple[Block, tuple[int, ...], tuple[Problem, ...]]:
    """Return the numbers of a table, without comments and headings among its rows.

    line      of the first row
    returned  block, first rows behind each heading, what is told of the lines left out

    Raises ``UnreadableFileError`` for other headings among the rows: the columns mean other
    things from there on.
    """
    rows, remarks = without_comments(body, line)
    block = parse_block(rows, start.layout, name, line)
    if not remarks and not any(problem.kind == "not_a_number" for problem in block.problems):
        return block, (), ()
    kept, begins, at = without_headings(body, start, name, line)
    if not at:
        return block, (), remarks
    rows, remarks = without_comments(kept, line)
    text = (
        f"the headings stand again at {len(at)} places, as where runs were put into one file: "
        "each begins with a memory of its own"
    )
    problem = Problem(kind="repeated_heading", place=f"line {at[0]}", text=text)
    return parse_block(rows, start.layout, name, line), begins, (*remarks, problem)


def columns_of(start: Start, block: Block) -> tuple[Column, ...]:
    """Return the columns of numbers, each under its heading."""
    return tuple(
        Column(
            number=k + 1,
            label=label,
            declared_unit="s" if k in block.stamped else unit_cell(unit),
            values=values,
        )
        for k, (label, unit, values) in enumerate(
            zip(start.labels, start.units, block.columns, strict=True)
        )
        if k not in block.textual
    )


def are_row_numbers(values: Array) -> bool:
    """Tell whether a column counts the rows."""
    return bool(values[0] in (0, 1) and (np.diff(values) == 1).all())


def stray_problems(start: Start) -> tuple[Problem, ...]:
    """Return what is odd about the lines above the table."""
    if not start.strays:
        return ()
    text = (
        f"{len(start.strays)} lines above the table hold numbers, but not "
        f"{start.layout.fields} of them; they are not read"
    )
    return (Problem(kind="rows_above", place=f"line {start.strays[0]}", text=text),)


def textual_problems(start: Start, block: Block) -> tuple[Problem, ...]:
    """Name the columns of text."""
    return tuple(
        Problem(
            kind="text_column",
            place=f"column {k + 1}",
            text=f"column {k + 1} {start.labels[k]!r} holds text and is not read",
        )
        for k in sorted(block.textual)
    )


def metadata_of(lines: tuple[str, ...]) -> dict[str, str]:
    """Return ``key: value``, ``key = value`` or ``key, value`` lines as pairs."""
    found = {}
    for line in lines:
        bare = line.strip().lstrip("#%/ ")
        for mark in ("\t", "=", ":", ";", ","):
            key, parted, value = bare.partition(mark)
            if parted and key.strip():
                found[key.strip().strip('"')] = value.strip().strip('"')
                break
    return found


def recognises(source: Source) -> bool:
    """Take whatever is not the beginning of some other binary file.

    Zero bytes behind some lines of text are damage to a text, which is told where it is read.
    """
    head = source.head
    begun = head[: head.find(b"\x00")] if b"\x00" in head else head
    return begun.count(b"\n") >= _LINES_OF_TEXT or (
        begun == head or encoding_of(head).startswith("utf-16")
    )


READER = Reader(
    name="text table",
    suffixes=(".csv", ".tsv", ".txt", ".dat", ".asc"),
    recognises=recognises,
    read=read,
)
