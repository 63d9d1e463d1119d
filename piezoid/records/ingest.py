"""ingest: from a file, and what lab.toml says about it, to a Recording."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import LabFileError, RecordingError, UnitError
from piezoid.records.assignment import Assignment, assign
from piezoid.records.clock import Clock, read_clock, stated_clock
from piezoid.records.conversion import Assigned
from piezoid.records.faults import faults_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.lost_readings import LeftOut, Sensed, left_out
from piezoid.records.own_axis import incomplete, own_axis, several_axes
from piezoid.records.readers import read_table
from piezoid.records.recording import Channel, Problem, Recording
from piezoid.records.refusal import lab_block
from piezoid.records.sample_rows import SampleRows
from piezoid.records.table import RawTable

Rows = NDArray[np.intp]

# lab.toml and the time column may differ by this much: crystals do, mistaken rates do not.
_RATE_TOLERANCE = 0.01


def ingest(path: Path, lab: Lab | None = None) -> Recording:
    """Read one file as one recording.

    Raises ``UnreadableFileError``, ``UnitError``, ``RecordingError`` or ``LabFileError``; what is
    merely odd (gaps, jitter, dead or clipped channels, rows without numbers) is in ``problems``.
    """
    lab = Lab() if lab is None else lab
    entries = lab.entries_of(path)
    if len(entries) > 1:
        raise LabFileError(
            f"{lab.place}: {path.name} has {len(entries)} [[recording]] entries",
            needed="one entry where one recording is asked for",
            remedy="Read them all with ingest_all, or keep one entry.",
        )
    return ingest_table(read_table(path), lab, entries[0] if entries else None)


def ingest_all(paths: Iterable[Path], lab: Lab | None = None) -> tuple[Recording, ...]:
    """Read several files, one recording for each ``[[recording]]`` entry of a file, or for it."""
    lab = Lab() if lab is None else lab
    found = []
    for path in paths:
        table = read_table(path)
        found += [ingest_table(table, lab, entry) for entry in lab.entries_of(path) or (None,)]
    return tuple(found)


def ingest_table(table: RawTable, lab: Lab, entry: RecordingEntry | None) -> Recording:
    """Make a recording of a table that has been read."""
    if table.independent and (entry is None or not entry.columns):
        raise RecordingError(
            f"{table.name}: a {table.format} table over {table.independent!r}, not over time",
            needed="a recording needs its columns as functions of time",
            remedy="Use it where a table is asked for (a tunnelling current against height), or "
            "name its columns and sampling_rate_Hz in lab.toml if they are samples in time.",
        )
    entry = RecordingEntry(file=table.name) if entry is None else entry
    assignment = assign(table, lab, entry)
    kept, row_problems = _kept_rows(table, assignment)
    clock = _clock(table, lab, entry, assignment, kept)
    rows = SampleRows.of(
        kept, {*clock.breaks, *_skips(kept), *_segments(table, kept)}, clock.bridged
    )
    rows = rows.cut(_part(entry, clock, len(rows.place)))
    lost = left_out(
        [_sensed(assigned, rows) for assigned in assignment.channels], rows.told(table)
    )
    channels = tuple(
        _channel(assigned, rows, number, lost)
        for number, assigned in enumerate(assignment.channels)
    )
    return Recording(
        name=table.name,
        digest=table.digest,
        axis=own_axis(entry, channels, lab.place),
        sampling_rate_Hz=clock.sampling_rate_Hz,
        channels=channels,
        breaks=rows.breaks,
        bridged=tuple(sorted({*rows.bridged, *lost.samples})),
        problems=(
            *table.problems,
            *assignment.problems,
            *row_problems,
            *clock.problems,
            *lost.problems,
            *faults_of(
                table, {a.column.number: a.quantity for a in assignment.channels if a.quantity}
            ),
            *incomplete(channels),
            *several_axes(entry, channels),
        ),
    )


def _kept_rows(table: RawTable, assignment: Assignment) -> tuple[Rows, tuple[Problem, ...]]:
    """Return the rows in which every column that is read holds a number."""
    read = [*assignment.channels, *([assignment.time] if assignment.time else [])]
    whole = np.ones(table.rows, dtype=bool)
    for assigned in read:
        whole &= np.isfinite(assigned.values)
    kept = np.flatnonzero(whole)
    if len(kept) < 2:
        counts = ", ".join(f"{a.column.place} {np.isfinite(a.values).sum()}" for a in read)
        raise RecordingError(
            f"{table.name}: {len(kept)} of {table.rows} rows hold a number in every column "
            f"(numbers in {counts})",
            needed="at least two whole rows",
            remedy="Leave the empty column out by naming the others in lab.toml.",
        )
    lost = table.rows - len(kept)
    if not lost:
        return kept, ()
    ends = int(kept[0]) + table.rows - 1 - int(kept[-1])
    first = int(np.flatnonzero(~whole)[0])
    empty = [a.column.place for a in read if not np.isfinite(a.values[first])]
    text = (
        f"{lost} rows lack a number, {ends} of them at the ends, {lost - ends} inside (behind a "
        f"break); the first is {table.place_of_row(first)}, {' and '.join(empty)}"
    )
    return kept, (Problem(kind="missing_values", place=table.place_of_row(first), text=text),)


def _skips(kept: Rows) -> list[int]:
    """First kept rows after rows that were left out."""
    return (np.flatnonzero(np.diff(kept) > 1) + 1).tolist()


def _segments(table: RawTable, kept: Rows) -> list[int]:
    starts = np.searchsorted(kept, np.array(table.segment_starts, dtype=int))
    return [int(k) for k in starts if 0 < k < len(kept)]


def _clock(
    table: RawTable, lab: Lab, entry: RecordingEntry, assignment: Assignment, kept: Rows
) -> Clock:
    """Return the clock, its breaks and single losses counted in kept rows.

    It is read from every row with a stamp, so that a row left out for another column's sake is no
    gap in time besides.
    """
    declared_Hz = entry.sampling_rate_Hz
    if assignment.time is None:
        return _stated_clock(table, lab, declared_Hz)
    stamped = np.flatnonzero(np.isfinite(assignment.time.values))
    clock = read_clock(
        assignment.time.values[stamped],
        table.name,
        lambda row: table.place_of_row(int(stamped[row])),
    )
    if declared_Hz is not None:
        _check_rate(table, lab, declared_Hz, clock.sampling_rate_Hz)
    return replace(
        clock,
        breaks=_counted(stamped[list(clock.breaks)], kept),
        bridged=_counted(stamped[list(clock.bridged)], kept),
    )


def _counted(rows: Rows, kept: Rows) -> tuple[int, ...]:
    """Return the numbers of the first kept rows from some rows on."""
    at = np.searchsorted(kept, rows)
    return tuple(sorted({int(k) for k in at if 0 < k < len(kept)}))


def _stated_clock(table: RawTable, lab: Lab, declared_Hz: float | None) -> Clock:
    """The clock of a table without time column: the format's, the entry's, the laboratory's."""
    stated_Hz = table.sampling_rate_Hz
    rate_Hz = stated_Hz or declared_Hz or lab.acquisition.sampling_rate_Hz
    if rate_Hz is None:
        raise UnitError(
            f"{table.name}: no column is a time and the file states no sampling rate",
            needed="a clock",
            remedy="Write into lab.toml 'sampling_rate_Hz = ...' under [acquisition] or under the "
            f"file's own entry, or name its time column:\n\n{lab_block(table)}\n",
        )
    clock = stated_clock(rate_Hz, table.name)
    if stated_Hz is not None and declared_Hz is not None:
        _check_rate(table, lab, declared_Hz, stated_Hz)
    return clock


def _check_rate(table: RawTable, lab: Lab, declared_Hz: float, found_Hz: float) -> None:
    if abs(declared_Hz - found_Hz) > _RATE_TOLERANCE * found_Hz:
        raise LabFileError(
            f"{lab.place}: sampling_rate_Hz of {table.name} is {declared_Hz:.9g} Hz, the file's "
            f"own clock says {found_Hz:.9g} Hz",
            needed="one rate, or no time column",
            remedy="Correct the rate or the unit of the time column.",
        )


def _part(entry: RecordingEntry, clock: Clock, samples: int) -> slice:
    """Return the samples between start_s and stop_s, counted from the first sample."""
    start = 0 if entry.start_s is None else round(entry.start_s * clock.sampling_rate_Hz)
    stop = samples if entry.stop_s is None else round(entry.stop_s * clock.sampling_rate_Hz) + 1
    start, stop = max(0, start), min(samples, stop)
    if stop - start < 2:
        raise LabFileError(
            f"lab.toml: {entry.file} from {entry.start_s} s to {entry.stop_s} s holds "
            f"{max(0, stop - start)} samples of its {samples / clock.sampling_rate_Hz:.6g} s",
            needed="at least two samples",
            remedy="Correct start_s and stop_s, counted from the first sample of the file.",
        )
    return slice(start, stop)


def _sensed(assigned: Assigned, rows: SampleRows) -> Sensed:
    assert assigned.quantity is not None
    return Sensed(
        quantity=assigned.quantity,
        axis=assigned.axis,
        place=assigned.column.place,
        unit=assigned.unit.symbol,
        factor=assigned.unit.factor,
        values=rows.values(assigned.column.values),
    )


def _channel(assigned: Assigned, rows: SampleRows, number: int, lost: LeftOut) -> Channel:
    assert assigned.quantity is not None
    column = assigned.column
    return Channel(
        quantity=assigned.quantity,
        axis=assigned.axis,
        values=lost.of(number, rows.values(assigned.values)),
        label=column.label or f"column {column.number}",
    )
