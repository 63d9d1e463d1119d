"""Channels of a lower sampling rate on the clock of a faster one: cells blank at a fixed interval.

Loggers merge channels of two rates into one table. The rows in which every channel was measured
make a recording at the lower rate; blanks without a fixed interval stay missing values.
"""

from dataclasses import replace

import numpy as np

from piezoid.records.columns import Assignment
from piezoid.records.table import RawTable
from piezoid.statement import Statement, finding

MIN_ROWS = 20  # measured rows by which an interval is known
MAX_IRREGULAR = 0.01  # of the measured rows may be missing besides


def on_common_rows(
    table: RawTable, assignment: Assignment
) -> tuple[RawTable, tuple[Statement, ...]]:
    """Return the rows of the slowest channel where its cells are blank at a fixed interval.

    Returns:
        The table of every n-th row and a statement that says so, or the table as it is.
    """
    intervals = [_interval(channel.column.values) for channel in assignment.channels]
    slowest = max(intervals, key=lambda interval: interval[1], default=(0, 1))
    first, step = slowest
    if step == 1 or any(step % other for _, other in intervals):
        return table, ()
    if assignment.time is None and table.sampling_rate_Hz is None:
        return table, ()  # a stated rate is of all rows
    labels = [
        channel.column.place
        for channel, interval in zip(assignment.channels, intervals, strict=True)
        if interval[1] > 1
    ]
    text = (
        f"{' and '.join(labels)} was measured in one of {step} rows, at a lower rate than the "
        f"other columns: only these rows are read, from {table.place_of_row(first)} on"
    )
    return (
        replace(
            table,
            columns=tuple(replace(c, values=c.values[first::step]) for c in table.columns),
            sampling_rate_Hz=table.sampling_rate_Hz and table.sampling_rate_Hz / step,
            segment_starts=tuple(max(0, -(-(s - first) // step)) for s in table.segment_starts),
            first_line=0,
        ),
        (finding(quantity="slower_channel", place=labels[0], text=text),),
    )


def _interval(values: np.ndarray) -> tuple[int, int]:
    """Return first row and interval of the cells that hold numbers; (0, 1) without one."""
    measured = np.flatnonzero(np.isfinite(values))
    if not MIN_ROWS <= len(measured) <= len(values) / 2 + 1:
        return 0, 1
    steps = np.diff(measured)
    step = int(np.median(steps))
    first = int(measured[0])
    is_on_grid = bool(((measured - first) % step == 0).all())
    expected = 1 + (len(values) - 1 - first) // step
    is_whole = len(measured) >= (1 - MAX_IRREGULAR) * expected
    return (first, step) if step > 1 and is_on_grid and is_whole else (0, 1)
