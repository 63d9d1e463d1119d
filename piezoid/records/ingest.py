"""ingest: from a file, and what lab.toml says about it, to a Recording."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from piezoid.counts import record_in_counts
from piezoid.errors import LabFileError, RecordingError, UnitError
from piezoid.records.assignment import Assignment, assign
from piezoid.records.clock import (
    Clock,
    print_resolution_s,
    read_clock,
    refuse_newest_first,
    stated_clock,
)
from piezoid.records.conversion import Assigned
from piezoid.records.faults import faults_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.lost_readings import LeftOut, Sensed, left_out
from piezoid.records.meaning import Role, meaning_of
from piezoid.records.own_axis import incomplete, own_axis, several_axes
from piezoid.records.plausibility import remarks_on
from piezoid.records.rates import stretches_of_one_rate
from piezoid.records.readers import read_table
from piezoid.records.recording import Channel, Recording
from piezoid.records.refusal import lab_block
from piezoid.records.response_columns import is_response
from piezoid.records.response_ingest import refused_as_recording
from piezoid.records.sample_rows import SampleRows
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension
from piezoid.records.which_voltage import beyond_the_controller
from piezoid.records.zero_jumps import told_jumps
from piezoid.statement import Statement, finding

Rows = NDArray[np.intp]

# lab.toml and the time column may differ by this much: crystals do, mistaken rates do not.
_RATE_TOLERANCE = 0.01


def ingest(path: Path, lab: Lab | None = None) -> Recording:
    """Read one file as one recording.

    Raises ``UnreadableFileError``, ``UnitError``, ``RecordingError`` or ``LabFileError``; what is
    merely odd (gaps, jitter, dead or clipped channels, rows without numbers) is in ``statements``.
    """
    lab = Lab() if lab is None else lab
    entries = lab.entries_of(path)
    if len(entries) > 1:
        raise LabFileError(
            f"{lab.place}: {path.name} has {len(entries)} [[recording]] entries",
            needed="one entry where one recording is asked for",
            remedy="Read them all with ingest_all, or keep one entry.",
        )
    found = ingest_parts(
        read_table(path, lab.text_format_of(path)), lab, next(iter(entries), None)
    )
    if len(found) > 1:
        stretches = ", ".join(
            f"{part.sampling_rate_Hz:.9g} Hz for {part.duration_s:.6g} s" for part in found
        )
        raise RecordingError(
            f"{path.name}: it holds {len(found)} stretches of different rate: {stretches}",
            needed="one rate where one recording is asked for",
            remedy="Read them all with ingest_all, or state start_s and stop_s in lab.toml.",
        )
    return found[0]


def ingest_all(paths: Iterable[Path], lab: Lab | None = None) -> tuple[Recording, ...]:
    """Read several files, one recording for each ``[[recording]]`` entry of a file, or for it.

    A file whose sampling rate changes gives a recording for each stretch of one rate.
    """
    lab, paths = Lab() if lab is None else lab, tuple(paths)
    lab.check_files(paths)
    found: list[Recording] = []
    for path in paths:
        table = read_table(path, lab.text_format_of(path))
        for entry in lab.entries_of(path) or (None,):
            found += ingest_parts(table, lab, entry)
    return tuple(found)


def ingest_parts(table: RawTable, lab: Lab, entry: RecordingEntry | None) -> tuple[Recording, ...]:
    """Make one recording of a table, or one for each stretch in which its rate is the same.

    Raises ``RecordingError`` for a frequency response, beside what a table may lack.
    """
    if is_response(table, entry):
        raise refused_as_recording(table)
    parts = parts_of(table, lab, entry)
    return tuple(with_remarks(ingest_table(*part), lab) for part in parts)


def parts_of(
    table: RawTable, lab: Lab, entry: RecordingEntry | None
) -> tuple[tuple[RawTable, Lab, RecordingEntry | None], ...]:
    """Cut a table where its sampling rate changes; each part is read by itself.

    returned  what ``ingest_table`` makes each recording of: a part has ``(part 1 of 3)`` in its
              name, and start_s and stop_s of the entry are counted from its own first sample
    """
    whole = ((table, lab, entry),)
    if table.independent:
        return whole
    time = assign(table, lab, entry or RecordingEntry(file=table.name)).time
    if time is None or (entry is not None and entry.sampling_rate_Hz is not None):
        return whole
    time_s = time.values[::-1] if entry is not None and entry.reverse else time.values
    stamped = np.flatnonzero(np.isfinite(time_s))
    stamps_s = time_s[stamped]
    found = stretches_of_one_rate(stamps_s, print_resolution_s(stamps_s)) if len(stamped) else ()
    if len(found) < 2:
        return whole
    if entry is not None and entry.reverse:
        table, entry = table.reversed(), structs.replace(entry, reverse=False)
    begins_s = [float(stamps_s[part.start] - stamps_s[0]) for part in found]
    ends_s = [float(stamps_s[part.stop - 1] - stamps_s[0]) for part in found]
    starts = [0, *(int(stamped[part.start]) for part in found[1:])]
    told = f"{len(found)} stretches of different rate, which begin at " + ", ".join(
        f"{table.place_of_row(row)} (t = {stamps_s[part.start]:.6g} s)"
        for row, part in zip(starts, found, strict=True)
    )
    statement = finding(
        quantity="several_rates",
        place=table.place_of_row(starts[1]),
        text=f"{told}; each is a recording of its own, with its own memory",
    )
    parts = []
    for k, (start, stop) in enumerate(pairwise((*starts, table.rows))):
        own = entry and _shifted(entry, begins_s[k], ends_s[k])
        if entry is None or own is not None:
            name = f"{table.name} (part {k + 1} of {len(found)})"
            part = table.part(slice(start, stop), name)
            parts.append((replace(part, statements=(*part.statements, statement)), lab, own))
    return tuple(parts) or whole


def _shifted(entry: RecordingEntry, begin_s: float, end_s: float) -> RecordingEntry | None:
    """Return an entry with its start and stop counted from a part, None where it is not in it."""
    start_s = 0.0 if entry.start_s is None else entry.start_s
    stop_s = np.inf if entry.stop_s is None else entry.stop_s
    if start_s >= end_s or stop_s <= begin_s:
        return None
    return structs.replace(
        entry,
        start_s=start_s - begin_s if start_s > begin_s else None,
        stop_s=stop_s - begin_s if stop_s < end_s else None,
    )


def with_remarks(recording: Recording, lab: Lab) -> Recording:
    """Return a recording with what is remarkable about drive and response together.

    Where the zero jumped, a piece ends.
    """
    edges, jumps = told_jumps(recording)
    said = (*remarks_on(recording), *jumps, *beyond_the_controller(recording, lab))
    statements = (*recording.statements, *record_in_counts(said, recording.counted))
    breaks = tuple(sorted({*recording.breaks, *edges}))
    return replace(recording, breaks=breaks, statements=statements)


def ingest_table(table: RawTable, lab: Lab, entry: RecordingEntry | None) -> Recording:
    """Make a recording of a table that has been read."""
    if table.independent and (entry is None or not entry.columns):
        raise RecordingError(
            f"{table.name}: a {table.format} table over {table.independent!r}, not over time",
            needed="columns as functions of time",
            remedy="Use it where a table is asked for (a tunnelling current against height), or "
            "name its columns and sampling_rate_Hz in lab.toml if they are samples in time.",
        )
    entry = RecordingEntry(file=table.name) if entry is None else entry
    table = table.reversed() if entry.reverse else table
    assignment = assign(table, lab, entry)
    once, repeat_problems = _rows_once(table, assignment)
    kept, row_problems = _kept_rows(table, assignment, once)
    clock = _clock(table, lab, entry, assignment, kept, once)
    rows = SampleRows.of(
        kept, {*clock.breaks, *_skips(kept, once), *_segments(table, kept)}, clock.bridged
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
        statements=(
            *table.statements,
            *assignment.statements,
            *repeat_problems,
            *row_problems,
            *clock.statements,
            *lost.statements,
            *_not_yet_told(
                faults_of(
                    table, {a.column.number: a.quantity for a in assignment.channels if a.quantity}
                ),
                lost,
            ),
            *incomplete(channels),
            *several_axes(entry, channels),
        ),
    )


def _rows_once(table: RawTable, assignment: Assignment) -> tuple[Rows, tuple[Statement, ...]]:
    """Return the rows without those that were written again: same stamp, same numbers.

    They are taken for that only where every stamp is one row's once they are gone: stamps of few
    digits are shared by many samples, some of which may be alike.
    """
    everything = np.arange(table.rows)
    time_s = None if assignment.time is None else assignment.time.values
    if time_s is None or not (np.diff(time_s[np.isfinite(time_s)]) <= 0).any():
        return everything, ()
    _, first, group = np.unique(time_s, return_index=True, return_inverse=True, equal_nan=False)
    again = (first[group] != everything) & np.isfinite(time_s)
    for channel in assignment.channels:
        earlier = channel.values[first[group]]
        again &= (channel.values == earlier) | (np.isnan(channel.values) & np.isnan(earlier))
    once = everything[~again]
    stamps_s = time_s[once]
    stamps_s = stamps_s[np.isfinite(stamps_s)]
    if not again.any() or len(np.unique(stamps_s)) < len(stamps_s):
        return everything, ()
    at = np.flatnonzero(again)
    text = (
        f"{len(at)} rows are written twice, with the same stamp and the same numbers; each is "
        f"read once. The first is {table.place_of_row(int(at[0]))}, t = {time_s[at[0]]:.6g} s"
    )
    place = table.place_of_row(int(at[0]))
    return once, (finding(quantity="repeated_rows", place=place, text=text),)


def _kept_rows(
    table: RawTable, assignment: Assignment, once: Rows
) -> tuple[Rows, tuple[Statement, ...]]:
    """Return the rows in which every column that is read holds a number.

    once  the rows to choose from
    """
    read = [*assignment.channels, *([assignment.time] if assignment.time else [])]
    whole = np.ones(len(once), dtype=bool)
    for assigned in read:
        whole &= np.isfinite(assigned.values[once])
    kept = once[whole]
    if len(kept) < 2:
        counts = ", ".join(f"{a.column.place} {np.isfinite(a.values).sum()}" for a in read)
        raise RecordingError(
            f"{table.name}: {len(kept)} of {table.rows} rows hold a number in every column "
            f"(numbers in {counts})",
            needed="at least two whole rows",
            remedy="Leave the empty column out by naming the others in lab.toml.",
        )
    lost = len(once) - len(kept)
    if not lost:
        return kept, ()
    held = np.flatnonzero(whole)
    ends = int(held[0]) + len(once) - 1 - int(held[-1])
    first = int(once[np.flatnonzero(~whole)[0]])
    empty = [a.column.place for a in read if not np.isfinite(a.values[first])]
    text = (
        f"{lost} rows lack a number, {ends} of them at the ends, {lost - ends} inside (behind a "
        f"break); the first is {table.place_of_row(first)}, {' and '.join(empty)}"
    )
    return kept, (finding(quantity="missing_values", place=table.place_of_row(first), text=text),)


def _skips(kept: Rows, once: Rows) -> list[int]:
    """First kept rows after rows that were left out for lack of a number."""
    return (np.flatnonzero(np.diff(np.searchsorted(once, kept)) > 1) + 1).tolist()


def _segments(table: RawTable, kept: Rows) -> list[int]:
    starts = np.searchsorted(kept, np.array(table.segment_starts, dtype=int))
    return [int(k) for k in starts if 0 < k < len(kept)]


def _clock(
    table: RawTable,
    lab: Lab,
    entry: RecordingEntry,
    assignment: Assignment,
    kept: Rows,
    once: Rows,
) -> Clock:
    """Return the clock, its breaks and single losses counted in kept rows.

    It is read from every row with a stamp, so that a row left out for another column's sake is no
    gap in time besides.
    """
    declared_Hz = entry.sampling_rate_Hz
    if assignment.time is None:
        _refuse_newest_first(table)
        return _stated_clock(table, lab, declared_Hz)
    stamped = once[np.isfinite(assignment.time.values[once])]
    clock = read_clock(
        assignment.time.values[stamped],
        table.name,
        partial(_place_of, table, stamped),
    )
    if declared_Hz is not None:
        _check_rate(table, lab, declared_Hz, clock.sampling_rate_Hz)
    return replace(
        clock,
        breaks=_counted(stamped[list(clock.breaks)], kept),
        bridged=_counted(stamped[list(clock.bridged)], kept),
    )


def _refuse_newest_first(table: RawTable) -> None:
    """Refuse rows whose own stamps run backwards, though nobody named these stamps the clock."""
    for column in table.columns:
        if meaning_of(column.heading).role is Role.TIME:
            stamped = np.flatnonzero(np.isfinite(column.values))
            refuse_newest_first(
                column.si_values[stamped],
                table.name,
                partial(_place_of, table, stamped),
            )


def _place_of(table: RawTable, rows: Rows, row: int) -> str:
    return table.place_of_row(int(rows[row]))


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
            needed="one of the two, to know when each row was recorded",
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


def _not_yet_told(faults: tuple[Statement, ...], lost: LeftOut) -> tuple[Statement, ...]:
    """Return the faults but those of columns whose lost readings tell the same."""
    told = {(statement.quantity, statement.place) for statement in lost.statements}
    return tuple(fault for fault in faults if (fault.quantity, fault.place) not in told)


def _channel(assigned: Assigned, rows: SampleRows, number: int, lost: LeftOut) -> Channel:
    assert assigned.quantity is not None
    column = assigned.column
    return Channel(
        quantity=assigned.quantity,
        axis=assigned.axis,
        values=lost.of(number, rows.values(assigned.values)),
        label=column.label or f"column {column.number}",
        is_counted=assigned.unit.is_counted and assigned.unit.dimension is Dimension.OTHER,
    )
