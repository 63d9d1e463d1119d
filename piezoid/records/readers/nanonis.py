"""Nanonis ``.dat``: pairs of key and value, then ``[DATA]``, a heading and a table behind tabs."""

from piezoid.records.column_roles import Role, meaning_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, parse_numbers
from piezoid.records.readers.text_table import metadata_of
from piezoid.records.table import Column, RawTable

_MARK = "[DATA]"


def recognises(source: Source) -> bool:
    """Tell a Nanonis file by its first word and, if it is that short, by its data mark."""
    lines = source.head.split(b"\n")
    bare = [line.strip() for line in lines]
    return lines[0].startswith(b"Experiment\t") and (
        _MARK.encode() in bare or len(source.head) >= 1 << 16
    )


def read(source: Source) -> RawTable:
    """Read a Nanonis table; every column carries its unit in its heading.

    The first column is what the instrument swept (a bias, a height), unless it is a time.
    """
    lines = text_of(source).split("\n")
    marks = [row for row, line in enumerate(lines) if line.strip() == _MARK]
    if not marks or marks[0] + 2 >= len(lines):
        raise unreadable(
            source.name,
            f"no table behind {_MARK}",
            needed="a heading and rows of numbers after that line",
            remedy="Save the measurement in Nanonis again.",
        )
    row = marks[0] + 1
    labels = [label.strip() for label in lines[row].rstrip("\t ").split("\t")]
    layout = Layout(separator="\t", decimal=".", fields=len(labels))
    body = "\n".join(lines[row + 1 :])
    if not body.strip():
        raise unreadable(
            source.name,
            f"the heading on line {row + 1} has no rows below it",
            needed="rows of numbers",
            remedy="Save the measurement in Nanonis after the sweep has run.",
            line=row + 1,
        )
    block = parse_numbers(body, layout, source.name, row + 2)
    columns = tuple(
        Column(number=k + 1, label=label, values=values)
        for k, (label, values) in enumerate(zip(labels, block.columns, strict=True))
        if k not in block.textual
    )
    swept = columns[0]
    return RawTable(
        name=source.name,
        digest=source.digest,
        format="Nanonis",
        columns=columns,
        independent="" if meaning_of(swept.heading).role is Role.TIME else swept.label,
        first_line=row + 2,
        metadata=metadata_of(tuple(lines[: marks[0]])),
        statements=block.statements,
    )


READER = Reader(name="Nanonis", suffixes=(".dat",), recognises=recognises, read=read)
