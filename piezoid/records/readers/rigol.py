"""Rigol oscilloscope CSV: a time column called X, or a sequence with a start and an increment."""

from piezoid.numerics.arrays import Array
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, number_of, parse_numbers, split
from piezoid.records.table import Column, RawTable, rate_of


def recognises(source: Source) -> bool:
    """Tell it by its first line, which starts with X and names channels."""
    line = source.head.split(b"\n", 1)[0].decode("latin-1")
    cells = [cell.upper() for cell in split(line, ",")]
    return len(cells) > 1 and cells[0] == "X" and cells[1].replace(" ", "").startswith("CH")


def read(source: Source) -> RawTable:
    """Read either form. The X of these instruments is a time in seconds.

    With a start and an increment the second line holds ``Sequence``, the unit of each channel,
    then the two numbers in seconds; the rows count from 0.
    """
    lines = text_of(source).rstrip().split("\n")
    labels = [label for label in split(lines[0], ",") if label]
    second = split(lines[1], ",") if len(lines) > 1 else []
    has_units = bool(second) and number_of(second[0], ".") is None
    skipped = 2 if has_units else 1
    if len(lines) <= skipped:
        raise unreadable(
            source.name,
            "no rows below its headings",
            needed="rows of numbers",
            remedy="Save the waveform again.",
            line=skipped,
        )
    clocked = "Increment" in labels and has_units
    channels = [label for label in labels if label not in ("Start", "Increment")]
    body = "\n".join(lines[skipped:])
    fields = max(len(channels), len(split(lines[skipped], ",")))
    block = parse_numbers(
        body, Layout(separator=",", decimal=".", fields=fields), source.name, skipped + 1
    )
    increment_s, start_s = _clock(source, labels, second) if clocked else (None, 0.0)
    return RawTable(
        name=source.name,
        digest=source.digest,
        format="Rigol oscilloscope",
        columns=_columns(channels, second if has_units else [], block.columns, clocked),
        sampling_rate_Hz=rate_of(increment_s),
        sampling_start_s=start_s,
        first_line=skipped + 1,
        statements=block.statements,
    )


def _clock(source: Source, labels: list[str], second: list[str]) -> tuple[float, float]:
    at = labels.index("Increment")
    increment_s = number_of(second[at], ".") if at < len(second) else None
    start_s = number_of(second[at - 1], ".") if at < len(second) else None
    if increment_s is None or start_s is None or not increment_s > 0:
        raise unreadable(
            source.name,
            f"line 2 gives no positive time increment: {','.join(second)!r}",
            needed="a start and an increment in seconds",
            remedy="Save the waveform again.",
            line=2,
        )
    return increment_s, start_s


def _columns(
    channels: list[str], units: list[str], values: tuple[Array, ...], clocked: bool
) -> tuple[Column, ...]:
    columns = []
    for k, label in enumerate(channels):
        if k == 0 and clocked:
            continue
        columns.append(
            Column(
                number=k + 1,
                label="time (X)" if k == 0 else label,
                declared_unit="s" if k == 0 else (units[k] if k < len(units) else ""),
                values=values[k],
            )
        )
    return tuple(columns)


READER = Reader(name="Rigol oscilloscope", suffixes=(".csv",), recognises=recognises, read=read)
