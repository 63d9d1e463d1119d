"""Rigol oscilloscope CSV: a time column called X, or a sequence with a start and an increment."""

from dataclasses import replace

from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, number_of, split
from piezoid.records.readers.text_table import table_under
from piezoid.records.table import RawTable, rate_of


def recognises(source: Source) -> bool:
    """Recognise the format by its first line, which starts with X and names channels."""
    line = source.head.split(b"\n", 1)[0].decode("latin-1")
    cells = [cell.upper() for cell in split(line, ",")]
    return len(cells) > 1 and cells[0] == "X" and cells[1].replace(" ", "").startswith("CH")


def read(source: Source) -> RawTable:
    """Read both layouts. The X of these instruments is a time in seconds.

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


READER = Reader(
    name="Rigol oscilloscope", usual_suffixes=(".csv",), recognises=recognises, read=read
)
