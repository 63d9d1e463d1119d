"""LabVIEW ``.lvm``: a file header, then segments, each with its own header and its own rows.

The line that ends the headers, the units and the clock of each channel follow the format's
published description by National Instruments (Writer_Version 0.92 to 2).
"""

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.readers.reader import Reader, Source, text_of, unreadable
from piezoid.records.readers.text_numbers import (
    Layout,
    NumberTable,
    count_of,
    number_of,
    parse_numbers,
)
from piezoid.records.readers.text_table import metadata_of
from piezoid.records.table import Column, RawTable, rate_of
from piezoid.statement import finding

HEADER_END = "***End_of_Header***"


# Cells of the header by key, labels of the columns, their numbers, and line of the first row.
_Segment = tuple[dict[str, list[str]], list[str], NumberTable, int]


def read(source: Source) -> RawTable:
    """Read and concatenate all segments."""
    lines = text_of(source).split("\n")
    header_ends = [row for row, line in enumerate(lines) if line.startswith(HEADER_END)]
    if len(header_ends) < 2:
        raise unreadable(
            source.name,
            f"{len(header_ends)} header ends",
            needed="one for the file and one for each segment",
            remedy="Write the file again from LabVIEW with headers.",
        )
    header = metadata_of(lines[: header_ends[0]])
    separator = {"Tab": "\t", "Comma": ","}.get(header.get("Separator", "Tab"), "\t")
    # Older writers do not state the decimal mark; it is found in the numbers.
    first_rows = "\n".join(lines[header_ends[1] + 2 : header_ends[1] + 50])
    has_commas = separator == "\t" and re.search(r"\d,\d", first_rows)
    decimal = header.get("Decimal_Separator") or ("," if has_commas else ".")
    starts = [
        next(
            (row for row in range(end, begin, -1) if lines[row].startswith("Channels")), begin + 1
        )
        for begin, end in pairwise(header_ends)
    ]
    segments: list[_Segment] = []
    stops = [*starts[1:], len(lines)]
    for start, end, stop in zip(starts, header_ends[1:], stops, strict=True):
        rows = [line for line in lines[end + 2 : stop] if line.strip()]
        if not rows:
            raise unreadable(
                source.name,
                f"no rows after the header that ends on line {end + 1}",
                needed="a heading and rows of numbers",
                remedy="Write the file again from LabVIEW.",
                line=end + 1,
            )
        labels = [label.strip() for label in lines[end + 1].split(separator)]
        labels = labels[:-1] if labels[-1] in ("Comment", "") else labels
        # The comments in a further column are cut off before the numbers are parsed.
        width = len(labels)
        if any(line.count(separator) >= width for line in rows):
            rows = [separator.join(line.split(separator)[:width]) for line in rows]
        layout = Layout(separator=separator, decimal=decimal, fields=width)
        block = parse_numbers("\n".join(rows), layout, source.name, end + 3)
        pairs = [line.split(separator) for line in lines[start:end] if line.strip()]
        fields = {key.strip(): [cell.strip() for cell in cells] for key, *cells in pairs}
        segments.append((fields, labels, block, end + 3))
    return _join_segments(source.name, header, segments)


def _join_segments(name: str, header: dict[str, str], segments: Sequence[_Segment]) -> RawTable:
    first_header, labels, first_block, first_line = segments[0]
    for _, labels_of_segment, _, line in segments[1:]:
        if labels_of_segment != labels:
            raise unreadable(
                name,
                f"the segment at line {line} has channels {tuple(labels_of_segment)}, the first "
                f"{tuple(labels)}",
                needed="the same channels in every segment",
                remedy="Write the segments with different channels into separate files.",
                line=line,
            )
    intervals = sorted({cell for cell in first_header.get("Delta_X", []) if cell})
    if len(intervals) > 1:
        raise unreadable(
            name,
            f"its channels have different sampling intervals {intervals}",
            needed="one clock for all channels",
            remedy="Write the channels of each rate into a separate file.",
        )
    has_clock = any(
        label == "X_Value" and np.isfinite(values).any()
        for label, values in zip(labels, first_block.columns, strict=True)
    )
    decimal = header.get("Decimal_Separator", ".")
    numbers = (number_of(interval, decimal) for interval in intervals)
    interval_s = next((n for n in numbers if n is not None and np.isfinite(n)), 0.0)
    rows = [len(block.columns[0]) for _, _, block, _ in segments]
    declared = [
        max((n for n in map(count_of, cells.get("Samples", [])) if n is not None), default=0)
        for cells, _, _, _ in segments
    ]
    starts = [int(k) for k in np.cumsum(rows)[:-1]]
    # With ``Multi_Headings No`` a file of several segments has one header and a multiple of the
    # declared samples. With a time column the segments are visible in the clock.
    if not starts and not has_clock and declared[0] > 1 and rows[0] % declared[0] == 0:
        starts = list(range(declared[0], rows[0], declared[0]))
    truncated = [
        finding(
            "truncated",
            f"the header declares {samples} samples, the file holds {count}",
            place=f"line {line}",
        )
        for samples, count, (_, _, _, line) in zip(declared, rows, segments, strict=True)
        if samples > max(count, 1)
    ]
    return RawTable(
        columns=_columns(segments),
        sampling_rate_Hz=None if has_clock else rate_of(interval_s),
        segment_starts=tuple(starts),
        first_line=first_line if len(segments) == 1 else 0,
        statements=(*(s for _, _, block, _ in segments for s in block.statements), *truncated),
    )


def _columns(segments: Sequence[_Segment]) -> tuple[Column, ...]:
    """Return the channels with their units, and only one of equal clocks."""
    header, labels, first_block, _ = segments[0]
    units = header.get("Y_Unit_Label", [])
    columns: list[Column] = []
    clocks: list[Array] = []
    for k, label in enumerate(labels):
        values = np.concatenate([block.columns[k] for _, _, block, _ in segments])
        is_time = label == "X_Value"
        if is_time:
            is_empty = not np.isfinite(first_block.columns[k]).any()
            if is_empty or (clocks and np.array_equal(values, clocks[0])):
                continue
            clocks.append(values)
        # The line of units has a cell for each channel, and also for each clock in files with a
        # clock for each channel; its first field is the key.
        unit = units[k - 1] if 0 < k <= len(units) else ""
        columns.append(
            Column(
                number=k + 1,
                label="time (X_Value)" if is_time else label,
                declared_unit="s" if is_time else unit,
                values=values,
            )
        )
    return tuple(columns)


READER = Reader(
    name="LabVIEW measurement",
    usual_suffixes=(".lvm",),
    recognises=lambda source: source.head.startswith(b"LabVIEW Measurement"),
    read=read,
)
