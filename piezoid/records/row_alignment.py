"""Select the rows of a table that become samples, and align them with a uniform clock."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.columns import Assignment
from piezoid.records.table import RawTable
from piezoid.statement import Statement, finding

Rows = NDArray[np.intp]
MIN_ROWS = 20  # measured rows by which the interval of a slower channel is known
MAX_IRREGULAR = 0.01  # of the measured rows may be missing besides


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleRows:
    """Rows in the order of their samples.

    complete  (rows,)     of the table, with a number in every column that is read
    position  (samples,)  index into ``complete``; a half lies between two rows, where one is lost
    breaks    first sample after each break, increasing
    bridged   samples that lie between two rows
    """

    complete: Rows
    position: Array
    breaks: tuple[int, ...]
    bridged: tuple[int, ...]

    @classmethod
    def of(cls, complete: Rows, breaks: Collection[int], missing: Collection[int]) -> "SampleRows":
        """Return all complete rows, with an inserted sample for each missing one.

        breaks   indices of complete rows before which memory ends
        missing  indices in front of which exactly one sample is missing; ignored at a break
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

    def cut(self, part: slice) -> "SampleRows":
        """Return a range of the samples."""
        first, stop = part.start, part.stop
        return replace(
            self,
            position=self.position[part],
            breaks=tuple(b - first for b in self.breaks if first < b < stop),
            bridged=tuple(b - first for b in self.bridged if first <= b < stop),
        )

    def source_row(self, sample: int) -> int:
        """Return the row of the table that a sample comes from, or the row before it."""
        return int(self.complete[int(self.position[sample])])

    def values(self, column: Array) -> Array:
        """Return the samples of a column, interpolated where a row is lost."""
        samples = np.interp(self.position, np.arange(len(self.complete)), column[self.complete])
        return np.asarray(samples)


def on_common_rows(
    table: RawTable, assignment: Assignment
) -> tuple[RawTable, tuple[Statement, ...]]:
    """Return the rows of the slowest channel where its cells are blank at a fixed interval.

    Loggers merge channels of two rates into one table. The rows in which every channel was
    measured make a recording at the lower rate; blanks without a fixed interval stay missing.

    Returns:
        The table of every n-th row and a statement that says so, or the table as it is.
    """
    intervals = [_interval(channel.column.values) for channel in assignment.channels]
    slowest = max(intervals, key=lambda interval: interval[1], default=(0, 1))
    first, step = slowest
    if step == 1 or any(step % interval for _, interval in intervals):
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
        (finding("slower_channel", text, place=labels[0]),),
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


def unique_rows(table: RawTable, assignment: Assignment) -> tuple[Rows, list[Statement]]:
    """Return the rows without repetitions: same time stamp, same numbers.

    Rows count as repeated only if all other stamps are distinct: stamps of few digits are shared
    by many samples, some of which may be equal.
    """
    every_row = np.arange(table.rows)
    time_s = None if assignment.time is None else assignment.time.values
    if time_s is None or not (np.diff(time_s[np.isfinite(time_s)]) <= 0).any():
        return every_row, []
    _, first, group = np.unique(time_s, return_index=True, return_inverse=True, equal_nan=False)
    is_repeated = (first[group] != every_row) & np.isfinite(time_s)
    for channel in assignment.channels:
        earlier = channel.values[first[group]]
        is_repeated &= (channel.values == earlier) | (np.isnan(channel.values) & np.isnan(earlier))
    stamps_s = time_s[~is_repeated]
    stamps_s = stamps_s[np.isfinite(stamps_s)]
    if not is_repeated.any() or len(np.unique(stamps_s)) < len(stamps_s):
        return every_row, []
    repeated = np.flatnonzero(is_repeated)
    location = table.place_of_row(int(repeated[0]))
    text = (
        f"{len(repeated)} rows are repeated (same stamp, same numbers) and read once. The first "
        f"is {location}, t = {time_s[repeated[0]]:.6g} s."
    )
    return every_row[~is_repeated], [finding("repeated_rows", text, place=location)]


def complete_rows(
    table: RawTable, assignment: Assignment, rows: Rows
) -> tuple[Rows, set[int], set[int], list[Statement]]:
    """Return the ``rows`` in which every column that is read holds a number.

    Returns:
        The rows; the indices of those that follow a single row in which only some channels lack
        a number; the indices of those that follow several such rows or a blank one; a statement.
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
            remedy="Leave the empty column out by naming the others in lab.toml.",
        )
    incomplete = np.flatnonzero(~is_complete)
    if not len(incomplete):
        return complete, set(), set(), []
    usable = np.flatnonzero(is_complete)
    at_ends = int(usable[0]) + len(rows) - 1 - int(usable[-1])
    is_blank = np.all([np.isnan(c.values[rows]) for c in assignment.channels], axis=0)
    resumed = np.flatnonzero(np.diff(usable) > 1) + 1
    is_single = (np.diff(usable)[resumed - 1] == 2) & ~is_blank[usable[resumed] - 1]
    single, several = set(resumed[is_single].tolist()), set(resumed[~is_single].tolist())
    row = int(rows[incomplete[0]])
    empty = [a.column.place for a in assignment.columns if not np.isfinite(a.values[row])]
    location = table.place_of_row(row)
    text = (
        f"{len(incomplete)} rows lack a number: {at_ends} at the ends, {len(single)} single ones "
        f"inside, bridged by straight lines, {len(incomplete) - at_ends - len(single)} in "
        f"{len(several)} gaps; the first is {location}, {' and '.join(empty)}"
    )
    return complete, single, several, [finding("missing_values", text, place=location)]


def positions_in(complete: Rows, rows: Rows) -> tuple[int, ...]:
    """Return the index of the first complete row at or after each of some rows, without ends."""
    indices = np.searchsorted(complete, rows)
    return tuple(sorted({int(k) for k in indices if 0 < k < len(complete)}))
