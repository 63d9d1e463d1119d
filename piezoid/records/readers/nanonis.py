"""Nanonis ``.dat``: pairs of key and value, then ``[DATA]``, headings and a table with tabs."""

from dataclasses import replace

from piezoid.records.column_roles import meaning_of
from piezoid.records.readers.reader import HEAD_SIZE, Reader, Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout
from piezoid.records.readers.text_table import metadata_of, table_under
from piezoid.records.table import RawTable

_MARK = "[DATA]"


def recognises(source: Source) -> bool:
    """Recognise a Nanonis file by its first word and, if it is short, by its data mark."""
    lines = [line.strip() for line in source.head.split(b"\n")]
    is_whole = len(source.head) < HEAD_SIZE
    return source.head.startswith(b"Experiment\t") and (_MARK.encode() in lines or not is_whole)


def read(source: Source) -> RawTable:
    """Read a Nanonis table, with the units in the headings.

    The first column is the swept quantity (a bias, a height), unless it is a time.
    """
    lines = text_of(source).split("\n")
    row = next((row for row, line in enumerate(lines) if line.strip() == _MARK), len(lines))
    body = "\n".join(lines[row + 2 :])
    if not body.strip():
        raise unreadable(
            source.name,
            f"no rows of numbers behind {_MARK}",
            needed="that line, a heading and rows of numbers after it",
            remedy="Save the measurement in Nanonis after the sweep has run.",
            line=row + 1,
        )
    labels = [label.strip() for label in lines[row + 1].rstrip("\t ").split("\t")]
    layout = Layout(separator="\t", decimal=".", fields=len(labels))
    table = table_under(source, [(label, "") for label in labels], body, layout, row + 3)
    swept = table.columns[0]
    return replace(
        table,
        independent="" if meaning_of(swept.heading).is_time else swept.label,
        metadata=metadata_of(lines[:row]),
    )


READER = Reader(name="Nanonis", usual_suffixes=(".dat",), recognises=recognises, read=read)
