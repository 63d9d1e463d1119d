"""LabVIEW ``.lvm``: a file header, then segments, each with its own header and its own rows.

The line that ends the headers, the units and the clock of each channel follow the format's
published description by National Instruments (Writer_Version 0.92 to 2).
"""

import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, count_of, number_of, parse_numbers
from piezoid.records.readers.text_table import metadata_of
from piezoid.records.table import Column, RawTable, rate_of
from piezoid.statement import Statement, finding

HEADER_END = "***End_of_Header***"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Segment:
    labels: tuple[str, ...]
    header: dict[str, list[str]]
    fields: tuple[Array, ...]
    line: int
    statements: tuple[Statement, ...]


def read(source: Source) -> RawTable:
    """Read all segments and put them one behind the other."""
    lines = text_of(source).split("\n")
    header_ends = [row for row, line in enumerate(lines) if line.startswith(HEADER_END)]
    if len(header_ends) < 2:
        raise unreadable(
            source.name,
            f"{len(header_ends)} header ends",
            needed="one for the file and one for each segment",
            remedy="Write the file again from LabVIEW with headers.",
        )
    header = metadata_of(tuple(lines[: header_ends[0]]))
    separator = {"Tab": "\t", "Comma": ","}.get(header.get("Separator", "Tab"), "\t")
    decimal = header.get("Decimal_Separator") or _decimal_mark(lines, header_ends[1], separator)
    starts = [_segment_start(lines, previous, end) for previous, end in pairwise(header_ends)]
    segments = [
        _segment(source.name, lines, begin, end, stop, separator, decimal)
        for begin, end, stop in zip(
            starts, header_ends[1:], [*starts[1:], len(lines)], strict=True
        )
    ]
    return _joined(source, header, segments)


def _segment_start(lines: list[str], previous_end: int, end: int) -> int:
    """Return the first line of the header that ends at ``end``."""
    row = end
    while row > previous_end + 1 and not lines[row].startswith("Channels"):
        row -= 1
    return row


def _decimal_mark(lines: list[str], end: int, separator: str) -> str:
    """Return the decimal mark of the numbers themselves, which older writers do not state."""
    for line in lines[end + 2 : end + 50]:
        if separator == "\t" and re.search(r"\d,\d", line):
            return ","
    return "."


def _segment(
    name: str, lines: list[str], begin: int, end: int, stop: int, separator: str, decimal: str
) -> _Segment:
    pairs = [line.rstrip("\n").split(separator) for line in lines[begin:end] if line.strip()]
    if end + 2 >= stop:
        raise unreadable(
            name,
            f"no rows after the header that ends on line {end + 1}",
            needed="a heading and rows of numbers",
            remedy="Write the file again from LabVIEW.",
            line=end + 1,
        )
    labels = [label.strip() for label in lines[end + 1].split(separator)]
    labels = labels[:-1] if labels[-1] in ("Comment", "") else labels
    rows = [line for line in lines[end + 2 : stop] if line.strip()]
    # A comment column is text of its own; cut it off before the numbers are parsed.
    width = len(labels)
    if any(line.count(separator) >= width for line in rows):
        rows = [separator.join(line.split(separator)[:width]) for line in rows]
    layout = Layout(separator=separator, decimal=decimal, fields=width)
    if not rows:
        raise unreadable(
            name,
            f"no rows after the heading on line {end + 2}",
            needed="rows of numbers",
            remedy="Write the file again from LabVIEW.",
            line=end + 2,
        )
    block = parse_numbers("\n".join(rows), layout, name, end + 3)
    return _Segment(
        labels=tuple(labels),
        header={pair[0].strip(): [cell.strip() for cell in pair[1:]] for pair in pairs},
        fields=block.columns,
        line=end + 3,
        statements=block.statements,
    )


def _joined(source: Source, header: dict[str, str], segments: list[_Segment]) -> RawTable:
    first = segments[0]
    for segment in segments[1:]:
        if segment.labels != first.labels:
            raise unreadable(
                source.name,
                f"the segment at line {segment.line} has channels {segment.labels}, the first "
                f"{first.labels}",
                needed="the same channels in every segment",
                remedy="Split the file into one for each set of channels.",
                line=segment.line,
            )
    lengths = [len(segment.fields[0]) for segment in segments]
    times = [k for k, label in enumerate(first.labels) if label == "X_Value"]
    clocks = [k for k in times if np.isfinite(first.fields[k]).any()]
    interval_s = _interval_s(source.name, first, header)
    statements = [statement for segment in segments for statement in segment.statements]
    return RawTable(
        name=source.name,
        digest=source.digest,
        format="LabVIEW measurement",
        columns=_columns(segments, clocks),
        sampling_rate_Hz=None if clocks else rate_of(interval_s),
        sampling_start_s=_number(first.header.get("X0", []), header) if not clocks else 0.0,
        segment_starts=_segment_starts(segments, lengths, is_clocked=bool(clocks)),
        first_line=first.line if len(segments) == 1 else 0,
        metadata=header,
        statements=(*statements, *_missing_samples(segments)),
    )


def _segment_starts(
    segments: list[_Segment], lengths: list[int], *, is_clocked: bool
) -> tuple[int, ...]:
    """Return the first row of each further acquisition, with or without a header.

    A file with ``Multi_Headings No`` repeats nothing: it only holds a multiple of the samples that
    its one header declares. A time column shows them by itself.
    """
    starts = [int(k) for k in np.cumsum(lengths)[:-1]]
    declared = max(_declared_samples(segments[0]), default=0)
    if not starts and not is_clocked and declared > 1 and lengths[0] % declared == 0:
        starts = list(range(declared, lengths[0], declared))
    return tuple(starts)


def _declared_samples(segment: _Segment) -> list[int]:
    counts = map(count_of, segment.header.get("Samples", []))
    return [count for count in counts if count is not None]


def _columns(segments: list[_Segment], times: list[int]) -> tuple[Column, ...]:
    """Return the channels with their units, and one clock where all clocks are the same."""
    first = segments[0]
    units = first.header.get("Y_Unit_Label", [])
    joined = [np.concatenate([s.fields[k] for s in segments]) for k in range(len(first.labels))]
    repeated_clocks = [k for k in times[1:] if np.array_equal(joined[k], joined[times[0]])]
    columns = []
    for k, label in enumerate(first.labels):
        is_time = label == "X_Value"
        if is_time and (k not in times or k in repeated_clocks):
            continue
        # The unit line has a cell for each channel, and in files with one clock for each channel a
        # cell for each clock too; the row's first field is the key's place.
        unit = units[k - 1] if 0 < k <= len(units) else ""
        columns.append(
            Column(
                number=k + 1,
                label="time (X_Value)" if is_time else label,
                declared_unit="s" if is_time else unit,
                values=joined[k],
            )
        )
    return tuple(columns)


def _interval_s(name: str, segment: _Segment, header: dict[str, str]) -> float:
    intervals = {cell for cell in segment.header.get("Delta_X", []) if cell}
    if len(intervals) > 1:
        raise unreadable(
            name,
            f"its channels have different sampling intervals {sorted(intervals)}",
            needed="one clock for all channels",
            remedy="Write the channels of each rate into a file of their own.",
        )
    return _number(sorted(intervals), header)


def _number(cells: list[str], header: dict[str, str]) -> float:
    decimal = header.get("Decimal_Separator", ".")
    for cell in cells:
        value = number_of(cell, decimal) if cell else None
        if value is not None and np.isfinite(value):
            return value
    return 0.0


def _missing_samples(segments: list[_Segment]) -> list[Statement]:
    statements = []
    for segment in segments:
        declared = max(_declared_samples(segment), default=0)
        samples = len(segment.fields[0])
        if declared > max(samples, 1):
            statements.append(
                finding(
                    quantity="truncated",
                    place=f"line {segment.line}",
                    text=f"the header declares {declared} samples, the file holds {samples}",
                )
            )
    return statements


READER = Reader(
    name="LabVIEW measurement",
    suffixes=(".lvm",),
    recognises=lambda source: source.head.startswith(b"LabVIEW Measurement"),
    read=read,
)
