"""Select the rows of a table that become samples, and align them with a uniform clock."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import LabFileError, RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.columns import Assignment
from piezoid.records.lab import RecordingEntry
from piezoid.records.table import RawTable
from piezoid.statement import Statement, finding

Rows = NDArray[np.intp]
MIN_ROWS = 20  # measured rows needed to identify the interval of a slower channel
MAX_IRREGULAR = 0.01  # of the expected measured rows: share that may be missing


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleRows:
    """Rows of a table in the order of their samples.

    complete  (rows,)     rows with a number in every column that is read
    position  (samples,)  index into ``complete``; k + 1/2 for a lost sample between two rows
    breaks    first sample after each break, increasing
    bridged   lost samples, between two rows
    """

    complete: Rows
    position: Array
    breaks: tuple[int, ...]
    bridged: tuple[int, ...]

    @classmethod
    def of(cls, complete: Rows, breaks: Collection[int], missing: Collection[int]) -> "SampleRows":
        """Return all complete rows, with an inserted sample for each missing one.

        breaks   indices of the complete rows behind a break
        missing  indices of the complete rows behind exactly one missing sample; ignored at a break
        """
        inserted = np.array(sorted(set(missing) - set(breaks)), dtype=int)
        edges = np.array(sorted(breaks), dtype=int)
        positions = np.arange(len(complete), dtype=np.float64)
        return cls(
            complete=complete,
            position=np.insert(positions, inserted, inserted - 0.5),
            breaks=tuple((edges + np.searchsorted(inserted, edges)).tolist()),
            bridged=tuple((inserted + np.arange(len(inserted))).tolist()),
        )

    def selected(self, entry: RecordingEntry, sampling_rate_Hz: float) -> "SampleRows":
        """Return the samples between start_s and stop_s, counted from the first sample."""
        samples = len(self.position)
        first = 0 if entry.start_s is None else round(entry.start_s * sampling_rate_Hz)
        stop = samples if entry.stop_s is None else round(entry.stop_s * sampling_rate_Hz) + 1
        first, stop = max(0, first), min(samples, stop)
        if stop - first < 2:
            raise LabFileError(
                f"lab.toml: {entry.file} from {entry.start_s} s to {entry.stop_s} s holds "
                f"{max(0, stop - first)} samples of its {samples / sampling_rate_Hz:.6g} s",
                needed="at least two samples",
                remedy="Correct start_s and stop_s, counted from the first sample of the file.",
            )
        return replace(
            self,
            position=self.position[first:stop],
            breaks=tuple(b - first for b in self.breaks if first < b < stop),
            bridged=tuple(b - first for b in self.bridged if first <= b < stop),
        )

    def values(self, column: Array) -> Array:
        """Return the samples of a column, with lost rows interpolated."""
        samples = np.interp(self.position, np.arange(len(self.complete)), column[self.complete])
        return np.asarray(samples)


def select_common_rows(
    table: RawTable, assignment: Assignment
) -> tuple[RawTable, tuple[Statement, ...]]:
    """Select the rows of the slowest channel if it is blank in all but every n-th row.

    Loggers merge channels of two rates into one table. The rows in which every channel was
    measured make a recording at the lower rate; irregular blanks are missing numbers.

    Returns:
        The table of every n-th row with a statement, or the unchanged table.
    """
    # First row and interval of the cells with numbers; (0, 1) if they are irregular.
    intervals: list[tuple[int, int]] = []
    for channel in assignment.channels:
        measured = np.flatnonzero(np.isfinite(channel.column.values))
        first, step = 0, 1
        if MIN_ROWS <= len(measured) <= table.rows / 2 + 1:
            first, step = int(measured[0]), int(np.median(np.diff(measured)))
            is_on_grid = bool(((measured - first) % step == 0).all())
            expected = 1 + (table.rows - 1 - first) // step
            is_regular = len(measured) >= (1 - MAX_IRREGULAR) * expected
            if step == 1 or not (is_on_grid and is_regular):
                first, step = 0, 1
        intervals.append((first, step))
    first, step = max(intervals, key=lambda interval: interval[1], default=(0, 1))
    if step == 1 or any(step % interval for _, interval in intervals):
        return table, ()
    if assignment.time is None and table.sampling_rate_Hz is None:
        return table, ()  # the rate in lab.toml is that of all rows
    labels = [
        channel.column.place
        for channel, interval in zip(assignment.channels, intervals, strict=True)
        if interval[1] > 1
    ]
    text = (
        f"{' and '.join(labels)} was measured in one of {step} rows, at a lower rate than the "
        f"other columns: only these rows are read, from {table.row_name(first)} on"
    )
    return (
        replace(
            table,
            columns=tuple(replace(c, values=c.values[first::step]) for c in table.columns),
            sampling_rate_Hz=table.sampling_rate_Hz and table.sampling_rate_Hz / step,
            segment_starts=tuple(max(0, -(-(s - first) // step)) for s in table.segment_starts),
            first_line=0,
        ),
        (finding("slower_channel", text, place=labels[0]),),
    )


def unique_rows(table: RawTable, assignment: Assignment, statements: list[Statement]) -> Rows:
    """Return the rows without those that repeat a time stamp and its numbers; state how many.

    Rows are repetitions only if all other stamps are distinct: many samples share a stamp of few
    digits, and some of them may be equal.
    """
    every_row = np.arange(table.rows)
    time_s = None if assignment.time is None else assignment.time.values
    if time_s is None or not (np.diff(time_s[np.isfinite(time_s)]) <= 0).any():
        return every_row
    _, first, group = np.unique(time_s, return_index=True, return_inverse=True, equal_nan=False)
    is_repeated = (first[group] != every_row) & np.isfinite(time_s)
    for channel in assignment.channels:
        earlier = channel.values[first[group]]
        is_repeated &= (channel.values == earlier) | (np.isnan(channel.values) & np.isnan(earlier))
    stamps_s = time_s[~is_repeated]
    stamps_s = stamps_s[np.isfinite(stamps_s)]
    if not is_repeated.any() or len(np.unique(stamps_s)) < len(stamps_s):
        return every_row
    repeated = np.flatnonzero(is_repeated)
    location = table.row_name(int(repeated[0]))
    text = (
        f"{len(repeated)} rows are repeated (same stamp, same numbers) and read once. The first "
        f"is {location}, t = {time_s[repeated[0]]:.6g} s."
    )
    statements.append(finding("repeated_rows", text, place=location))
    return np.flatnonzero(~is_repeated)


def complete_rows(
    table: RawTable, assignment: Assignment, rows: Rows, statements: list[Statement]
) -> tuple[Rows, set[int], set[int]]:
    """Return the ``rows`` in which every column that is read holds a number.

    Returns:
        The complete rows; the indices of complete rows behind a single row in which some channels
        lack a number; the indices of complete rows behind a blank row or several incomplete rows.
    """
    is_complete = np.ones(len(rows), dtype=bool)
    for assigned in assignment.columns:
        is_complete &= np.isfinite(assigned.values[rows])
    complete = rows[is_complete]
    if len(complete) < 2:
        counts = ", ".join(
            f"{a.column.place} {np.isfinite(a.values).sum()}" for a in assignment.columns
        )
        raise RecordingError(
            f"{table.name}: {len(complete)} of {table.rows} rows hold a number in every column "
            f"(numbers in {counts})",
            needed="at least two complete rows",
            remedy="Name only the other columns in lab.toml, to leave the empty column out.",
        )
    incomplete = np.flatnonzero(~is_complete)
    if not len(incomplete):
        return complete, set(), set()
    usable = np.flatnonzero(is_complete)
    at_ends = int(usable[0]) + len(rows) - 1 - int(usable[-1])
    is_blank = np.all([np.isnan(c.values[rows]) for c in assignment.channels], axis=0)
    resumed = np.flatnonzero(np.diff(usable) > 1) + 1
    is_single = (np.diff(usable)[resumed - 1] == 2) & ~is_blank[usable[resumed] - 1]
    after_single, after_gap = (set(resumed[mask].tolist()) for mask in (is_single, ~is_single))
    row = int(rows[incomplete[0]])
    empty = [a.column.place for a in assignment.columns if not np.isfinite(a.values[row])]
    location = table.row_name(row)
    text = (
        f"{len(incomplete)} rows lack a number: {at_ends} at the ends, {len(after_single)} single "
        f"rows, which are interpolated, {len(incomplete) - at_ends - len(after_single)} in "
        f"{len(after_gap)} gaps; the first is {location}, {' and '.join(empty)}"
    )
    statements.append(finding("missing_values", text, place=location))
    return complete, after_single, after_gap


def positions_in(complete: Rows, rows: Rows) -> tuple[int, ...]:
    """Return the indices of the first complete rows at or after ``rows``, without the ends."""
    indices = np.searchsorted(complete, rows)
    return tuple(sorted({int(k) for k in indices if 0 < k < len(complete)}))
