"""CSV of oscilloscopes: Tektronix with its settings beside or above the samples, and Rigol."""

import re
from dataclasses import replace

import numpy as np

from piezoid.records.readers.reader import Reader, Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, number_of, split
from piezoid.records.readers.text_table import read_text, table_under
from piezoid.records.table import RawTable, rate_of
from piezoid.statement import finding

_SETTING_LINES = 60


def read_tektronix(source: Source) -> RawTable:
    """Read all channels, which must have the same clock.

    Every row is ``key, value, (blank), time, volts, (blank)`` for each saved channel; the settings
    end after some twenty rows, the samples continue.
    """
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
    table = table_under(source, headings, body, layout, 1)
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
        statements=(*truncated, *table.statements),
    )


def _settings(rows: list[list[str]], start: int) -> dict[str, str]:
    """Return the settings in two columns next to the first samples."""
    return {
        row[start]: row[start + 1]
        for row in rows[:_SETTING_LINES]
        if len(row) > start + 1 and row[start]
    }


def read_tektronix_above(source: Source) -> RawTable:
    """Read the later format: a text table with its units in the settings above it."""
    table = read_text(source, text_of(source))
    units = [
        table.metadata.get("Horizontal Units", "").strip(",").lower(),
        *table.metadata.get("Vertical Units", "").split(","),
    ]
    columns = tuple(
        replace(c, declared_unit=units[c.number - 1]) if c.number <= len(units) else c
        for c in table.columns
    )
    return replace(table, columns=columns)


def is_rigol(source: Source) -> bool:
    """Recognise a file of Rigol by its first line, which starts with X and names channels."""
    line = source.head.split(b"\n", 1)[0].decode("latin-1")
    cells = [cell.upper() for cell in split(line, ",")]
    return len(cells) > 1 and cells[0] == "X" and cells[1].replace(" ", "").startswith("CH")


def read_rigol(source: Source) -> RawTable:
    """Read both layouts of Rigol. The X of these instruments is a time in seconds.

    With a start and an increment the second line holds ``Sequence``, the unit of each channel,
    then the two numbers in seconds; the rows count from 0.
    """
    lines = text_of(source).rstrip().split("\n")
    labels = [label for label in split(lines[0], ",") if label]
    units = split(lines[1], ",") if len(lines) > 1 else []
    has_units = bool(units) and number_of(units[0], ".") is None
    skipped = 2 if has_units else 1
    if len(lines) <= skipped:
        raise unreadable(
            source.name,
            "no rows below its headings",
            needed="rows of numbers",
            remedy="Save the waveform again.",
            line=skipped,
        )
    channels = [label for label in labels if label not in ("Start", "Increment")]
    unit_of = dict(enumerate(units if has_units else []))
    headings = [
        ("time (X)", "s"),
        *((label, unit_of.get(k, "")) for k, label in enumerate(channels[1:], start=1)),
    ]
    fields = max(len(channels), len(split(lines[skipped], ",")))
    layout = Layout(separator=",", decimal=".", fields=fields)
    table = table_under(source, headings, "\n".join(lines[skipped:]), layout, skipped + 1)
    if not has_units or "Increment" not in labels:
        return table
    index = labels.index("Increment")
    increment_s = number_of(units[index], ".") if index < len(units) else None
    if increment_s is None or not increment_s > 0:
        raise unreadable(
            source.name,
            f"line 2 gives no positive time increment: {','.join(units)!r}",
            needed="an increment in seconds",
            remedy="Save the waveform again.",
            line=2,
        )
    return replace(
        table,
        columns=table.columns[1:],
        sampling_rate_Hz=rate_of(increment_s),
    )


TEKTRONIX = Reader(
    name="Tektronix oscilloscope",
    usual_suffixes=(".csv",),
    # The settings stand beside the first samples.
    recognises=lambda source: bool(
        re.match(rb'"?Record Length"?,[^\n]*,[^\n]*,[^\n]*,', source.head)
    ),
    read=read_tektronix,
)
TEKTRONIX_ABOVE = Reader(
    name="Tektronix oscilloscope, settings above",
    usual_suffixes=(".csv",),
    recognises=lambda source: all(
        re.search(line, source.head, re.MULTILINE)
        for line in (rb"^Horizontal Units,", rb"^Vertical Units,", rb"^TIME,")
    ),
    read=read_tektronix_above,
)
RIGOL = Reader(
    name="Rigol oscilloscope", usual_suffixes=(".csv",), recognises=is_rigol, read=read_rigol
)
