"""LabVIEW ``.lvm``: a file header, then segments, each with its own header and its own rows.

The line that ends the headers, the units and the clock of each channel follow the format's
published description by National Instruments (Writer_Version 0.92 to 2).
"""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np

from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, count_of, number_of, parse_numbers
from piezoid.records.readers.text_table import metadata_of
from piezoid.records.table import Column, RawTable, rate_of
from piezoid.statement import finding

HEADER_END = "***End_of_Header***"
CLOCK = "time (X_Value)"
Header = dict[str, list[str]]  # cells of the header of a segment by key


def read(source: Source) -> RawTable:
    """Read and concatenate all segments."""
    lines = text_of(source).split("\n")
    header_ends = [row for row, line in enumerate(lines) if line.startswith(HEADER_END)]
    if len(header_ends) < 2:
        raise unreadable(
            source.name,
            f"{len(header_ends)} header ends",
            needed="one for the file and one for each segment",
        )
    header = metadata_of(lines[: header_ends[0]])
    separator = {"Tab": "\t", "Comma": ","}.get(header.get("Separator", "Tab"), "\t")
    # Older writers do not state the decimal mark; it is found in the numbers.
    first_rows = "\n".join(lines[header_ends[1] + 2 : header_ends[1] + 50])
    has_commas = separator == "\t" and re.search(r"\d,\d", first_rows)
    decimal = header.get("Decimal_Separator") or ("," if has_commas else ".")
    layout = Layout(separator=separator, decimal=decimal, fields=0)
    starts = [
        next(
            (row for row in range(end, begin, -1) if lines[row].startswith("Channels")), begin + 1
        )
        for begin, end in pairwise(header_ends)
    ]
    segments = [
        _read_segment(source.name, lines[:stop], start, end, layout)
        for start, end, stop in zip(
            starts, header_ends[1:], [*starts[1:], len(lines)], strict=True
        )
    ]
    first_header, table = segments[0]
    for _, segment in segments[1:]:
        labels, first_labels = ([c.label for c in t.columns] for t in (segment, table))
        if labels != first_labels:
            raise unreadable(
                source.name,
                f"the segment at line {segment.first_line} has channels {tuple(labels)}, the "
                f"first {tuple(first_labels)}",
                needed="the same channels in every segment",
                remedy="Write the segments with different channels into separate files.",
            )
        table = table.followed_by(segment)
    columns = _used_columns(table, segments[0][1].rows)
    has_clock = any(column.label == CLOCK for column in columns)
    # With ``Multi_Headings No`` a file of several segments has one header and a multiple of the
    # declared samples. With a time column the segments are visible in the clock.
    declared = _declared_samples(first_header)
    if len(segments) == 1 and not has_clock and declared > 1 and table.rows % declared == 0:
        table = replace(table, segment_starts=tuple(range(0, table.rows, declared)))
    interval_s = _interval_s(source.name, first_header, header.get("Decimal_Separator", "."))
    return replace(
        table,
        columns=columns,
        sampling_rate_Hz=None if has_clock else rate_of(interval_s),
        segment_starts=table.segment_starts[1:],
        metadata=header,
    )


def _read_segment(
    name: str, lines: list[str], start: int, end: int, layout: Layout
) -> tuple[Header, RawTable]:
    """Read the segment to the end of the lines.

    start, end  first and last line of its header
    """
    separator = layout.separator
    rows = [line for line in lines[end + 2 :] if line.strip()]
    if not rows:
        raise unreadable(
            name,
            f"no rows after the header that ends on line {end + 1}",
            needed="a heading and rows of numbers",
        )
    labels = [label.strip() for label in lines[end + 1].split(separator)]
    labels = labels[:-1] if labels[-1] in ("Comment", "") else labels
    # The comments in a further column are cut off before the numbers are parsed.
    width = len(labels)
    if any(line.count(separator) >= width for line in rows):
        rows = [separator.join(line.split(separator)[:width]) for line in rows]
    block = parse_numbers("\n".join(rows), replace(layout, fields=width), name, end + 3)
    pairs = [line.split(separator) for line in lines[start:end] if line.strip()]
    header = {key.strip(): [cell.strip() for cell in cells] for key, *cells in pairs}
    # The line of units has a cell for each channel, and also for each clock in files with a
    # clock for each channel; its first field is the key.
    units = ["", *header.get("Y_Unit_Label", []), *[""] * width]
    columns = tuple(
        Column(
            number=k + 1,
            label=CLOCK if label == "X_Value" else label,
            declared_unit="s" if label == "X_Value" else units[k],
            values=block.columns[k],
        )
        for k, label in enumerate(labels)
    )
    table = RawTable(
        columns=columns, first_line=end + 3, segment_starts=(0,), statements=block.statements
    )
    if (declared := _declared_samples(header)) > max(table.rows, 1):
        text = f"the header declares {declared} samples, the file holds {table.rows}"
        truncated = finding("truncated", text, place=f"line {end + 3}")
        table = replace(table, statements=(*table.statements, truncated))
    return header, table


def _declared_samples(header: Header) -> int:
    counts = map(count_of, header.get("Samples", []))
    return max((count for count in counts if count is not None), default=0)


def _interval_s(name: str, header: Header, decimal: str) -> float:
    """Return the sampling interval of all channels, or 0 if none is stated."""
    intervals = sorted({cell for cell in header.get("Delta_X", []) if cell})
    if len(intervals) > 1:
        raise unreadable(
            name,
            f"its channels have different sampling intervals {intervals}",
            needed="one clock for all channels",
            remedy="Write the channels of each rate into a separate file.",
        )
    numbers = (number_of(interval, decimal) for interval in intervals)
    return next((n for n in numbers if n is not None and np.isfinite(n)), 0.0)


def _used_columns(table: RawTable, rows: int) -> tuple[Column, ...]:
    """Return the columns without repeated clocks, and without clocks empty in the first rows."""
    columns: list[Column] = []
    clocks: list[Column] = []
    for column in table.columns:
        if column.label == CLOCK:
            is_empty = not np.isfinite(column.values[:rows]).any()
            if is_empty or (clocks and np.array_equal(column.values, clocks[0].values)):
                continue
            clocks.append(column)
        columns.append(column)
    return tuple(columns)


READER = Reader(
    name="LabVIEW measurement",
    usual_suffixes=(".lvm",),
    recognises=lambda source: source.head.startswith(b"LabVIEW Measurement"),
    read=read,
)
