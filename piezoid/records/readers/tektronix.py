"""Tektronix oscilloscope CSV with its settings next to the samples.

Every row is ``key, value, (blank), time, volts, (blank)`` for each saved channel; the settings end
after some twenty rows, the samples continue.
"""

import re
from dataclasses import replace

import numpy as np

from piezoid.records.readers import text_table
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, number_of, split
from piezoid.records.table import RawTable
from piezoid.statement import finding

_SETTING_LINES = 60


def recognises(source: Source) -> bool:
    """Recognise the format by the settings next to the first samples."""
    return re.match(rb'"?Record Length"?,[^\n]*,[^\n]*,[^\n]*,', source.head) is not None


def read(source: Source) -> RawTable:
    """Read all channels, which must have the same clock."""
    rows = [split(line, ",") for line in text_of(source).rstrip().split("\n")]
    starts = [k for k, cell in enumerate(rows[0]) if cell == "Record Length"]
    fields: list[int] = []  # of the time and the value of each channel
    headings: list[tuple[str, str]] = []
    for channel, (start, stop) in enumerate(
        zip(starts, [*starts[1:], len(rows[0])], strict=True), start=1
    ):
        # Time and value are the first two numbers behind key and value of the setting.
        numbers = [
            k
            for k in range(start + 2, stop)
            if rows[0][k] and number_of(rows[0][k], ".") is not None
        ]
        if len(numbers) < 2:
            raise unreadable(
                source.name,
                f"line 1 holds no time and value beside the record length: {','.join(rows[0])!r}",
                needed="a time and a sample in every row",
                remedy="Save the waveform as CSV again.",
                line=1,
            )
        fields += numbers[:2]
        settings = _settings(rows, start)
        headings += [
            ("time", settings.get("Horizontal Units", "").lower()),
            (settings.get("Source") or f"channel {channel}", settings.get("Vertical Units", "")),
        ]
    body = "\n".join(",".join(row[k] if k < len(row) else "" for k in fields) for row in rows)
    layout = Layout(separator=",", decimal=".", fields=len(fields))
    table = text_table.table_under(source, headings, body, layout, 1)
    columns = [replace(column, number=fields[column.number - 1] + 1) for column in table.columns]
    for k in range(2, len(columns), 2):
        if not np.array_equal(columns[k].values, columns[0].values, equal_nan=True):
            raise unreadable(
                source.name,
                f"the times of channel {k // 2 + 1} differ from those of channel 1",
                needed="one clock for all channels",
                remedy="Save each channel into a separate file.",
            )
    settings = _settings(rows, starts[0])
    declared = number_of(settings.get("Record Length", ""), ".") or 0.0
    truncated = []
    if declared > table.rows:
        text = f"the settings declare {declared:.0f} samples, the file holds {table.rows}"
        truncated = [finding("truncated", text, place="line 1")]
    return replace(
        table,
        columns=(columns[0], *columns[1::2]),
        metadata=settings,
        statements=(*truncated, *table.statements),
    )


def _settings(rows: list[list[str]], start: int) -> dict[str, str]:
    """Return the settings in two columns next to the first samples."""
    return {
        row[start]: row[start + 1]
        for row in rows[:_SETTING_LINES]
        if len(row) > start + 1 and row[start]
    }


def recognises_above(source: Source) -> bool:
    """Recognise the later format, with settings above the samples, by unit lines and heading."""
    lines = (rb"^Horizontal Units,", rb"^Vertical Units,", rb"^TIME,")
    return all(re.search(line, source.head, re.MULTILINE) for line in lines)


def read_above(source: Source) -> RawTable:
    """Read the later format: a text table with its units in the settings above it."""
    table = text_table.read(source)
    units = [
        table.metadata.get("Horizontal Units", "").strip(",").lower(),
        *table.metadata.get("Vertical Units", "").split(","),
    ]
    columns = tuple(
        replace(c, declared_unit=units[c.number - 1]) if c.number <= len(units) else c
        for c in table.columns
    )
    return replace(table, columns=columns)


ABOVE = Reader(
    name="Tektronix oscilloscope, settings above",
    usual_suffixes=(".csv",),
    recognises=recognises_above,
    read=read_above,
)
READER = Reader(
    name="Tektronix oscilloscope", usual_suffixes=(".csv",), recognises=recognises, read=read
)
