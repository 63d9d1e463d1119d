"""Tektronix oscilloscope CSV with its settings side by side with the samples.

Every row is ``key, value, (blank), time, volts, (blank)`` for each channel saved; the settings run
out after some twenty rows, the samples go on.
"""

import re
from dataclasses import replace

import numpy as np

from piezoid.records.readers import text_table
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, number_of, parse_numbers, split
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

_SETTING_LINES = 60


def recognises(source: Source) -> bool:
    """Tell it by the setting every row of samples starts beside."""
    return re.match(rb'"?Record Length"?,[^\n]*,[^\n]*,[^\n]*,', source.head) is not None


def read(source: Source) -> RawTable:
    """Read all channels; their clocks must be one and the same."""
    lines = text_of(source).rstrip().split("\n")
    rows = [split(line, ",") for line in lines[:_SETTING_LINES]]
    width = len(rows[0])
    starts = [k for k, cell in enumerate(rows[0]) if cell == "Record Length"]
    pairs = [
        _samples_of(rows[0], begin, end)
        for begin, end in zip(starts, [*starts[1:], width], strict=True)
    ]
    if any(pair is None for pair in pairs):
        raise unreadable(
            source.name,
            f"line 1 holds no time and value beside the record length: {lines[0][:60]!r}",
            needed="a time and a sample in every row",
            remedy="Save the waveform as CSV again.",
            line=1,
        )
    settings = [_settings(rows, begin) for begin in starts]
    columns = _columns(source, lines, [pair for pair in pairs if pair is not None], settings)
    return RawTable(
        name=source.name,
        digest=source.digest,
        format="Tektronix oscilloscope",
        columns=columns,
        first_line=1,
        metadata=settings[0],
        statements=_missing(settings[0], len(columns[0].values)),
    )


def _samples_of(row: list[str], begin: int, end: int) -> tuple[int, int] | None:
    """Return the fields of time and value: the first two numbers behind key and value."""
    numbers = [k for k in range(begin + 2, end) if row[k] and number_of(row[k], ".") is not None]
    return (numbers[0], numbers[1]) if len(numbers) >= 2 else None


def _settings(rows: list[list[str]], begin: int) -> dict[str, str]:
    return {row[begin]: row[begin + 1] for row in rows if len(row) > begin + 1 and row[begin]}


def _columns(
    source: Source, lines: list[str], pairs: list[tuple[int, int]], settings: list[dict[str, str]]
) -> tuple[Column, ...]:
    wanted = [field for pair in pairs for field in pair]
    body = "\n".join(
        ",".join(cells[k] if k < len(cells) else "" for k in wanted)
        for cells in (split(line, ",") for line in lines)
    )
    layout = Layout(separator=",", decimal=".", fields=len(wanted))
    values = parse_numbers(body, layout, source.name, 1).columns
    for k in range(2, len(wanted), 2):
        if not np.array_equal(values[k], values[0], equal_nan=True):
            raise unreadable(
                source.name,
                f"the times of channel {k // 2 + 1} differ from those of channel 1",
                needed="one clock for all channels",
                remedy="Save each channel into a file of its own.",
            )
    columns = [
        Column(
            number=pairs[0][0] + 1,
            label="time",
            declared_unit=settings[0].get("Horizontal Units", "").lower(),
            values=values[0],
        )
    ]
    for k, (pair, setting) in enumerate(zip(pairs, settings, strict=True)):
        columns.append(
            Column(
                number=pair[1] + 1,
                label=setting.get("Source") or f"channel {k + 1}",
                declared_unit=setting.get("Vertical Units", ""),
                values=values[2 * k + 1],
            )
        )
    return tuple(columns)


def _missing(settings: dict[str, str], held: int) -> tuple[Statement, ...]:
    declared = number_of(settings.get("Record Length", ""), ".") or 0.0
    if not declared > held:
        return ()
    text = f"the settings declare {declared:.0f} samples, the file holds {held}"
    return (finding(quantity="truncated", place="line 1", text=text),)


def recognises_above(source: Source) -> bool:
    """Tell the later form, settings above the samples, by its unit lines and its heading."""
    wanted = (rb"^Horizontal Units,", rb"^Vertical Units,", rb"^TIME,")
    return all(re.search(line, source.head, re.MULTILINE) for line in wanted)


def read_above(source: Source) -> RawTable:
    """Read the later form: a text table whose units stand among the settings above it."""
    table = text_table.read(source)
    units = [
        table.metadata.get("Horizontal Units", "").strip(",").lower(),
        *table.metadata.get("Vertical Units", "").split(","),
    ]
    columns = tuple(
        replace(column, declared_unit=units[column.number - 1])
        if column.number <= len(units)
        else column
        for column in table.columns
    )
    return replace(table, columns=columns, format="Tektronix oscilloscope, settings above")


ABOVE = Reader(
    name="Tektronix oscilloscope, settings above",
    suffixes=(".csv",),
    recognises=recognises_above,
    read=read_above,
)
READER = Reader(
    name="Tektronix oscilloscope", suffixes=(".csv",), recognises=recognises, read=read
)
