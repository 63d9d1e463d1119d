"""Ingest: from a table and the declarations of lab.toml to recordings.

assign_columns -> unique_rows, complete_rows -> read_clock -> SampleRows
    -> find_invalid_readings -> Recording -> check_recording, find_baseline_steps
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from msgspec import structs

from piezoid.errors import LabFileError, RecordingError, UnitError
from piezoid.raw_counts import record_in_counts
from piezoid.records.baseline_steps import find_baseline_steps
from piezoid.records.checks import check_recording
from piezoid.records.checks.columns import check_columns
from piezoid.records.clock import (
    CONTROLLER_RATE,
    Clock,
    constant_rate_segments,
    read_clock,
    refuse_newest_first,
    stated_clock,
)
from piezoid.records.column_refusals import clocks_of, entry_template
from piezoid.records.columns import (
    AssignedColumn,
    Assignment,
    assign_columns,
)
from piezoid.records.invalid_samples import (
    find_invalid_readings,
    find_invalid_rows,
    interpolate_invalid,
    invalid_statement,
)
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid.records.row_alignment import (
    Rows,
    SampleRows,
    complete_rows,
    positions_in,
    select_common_rows,
    unique_rows,
)
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension
from piezoid.statement import Statement, finding

# Relative difference of the rates in lab.toml and in the time column: the error of a crystal is
# smaller, a mistake larger.
_RATE_TOLERANCE = 0.01
# Smallest and largest range of a moving channel, in SI units.
_POSSIBLE = {Quantity.DISPLACEMENT: (1e-13, 1.0), Quantity.VOLTAGE: (1e-6, 1e6)}
_USUAL_m = (1e-8, 1e-3)
_LENGTHS_m = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}

Part = tuple[RawTable, RecordingEntry]


def ingest_parts(table: RawTable, lab: Lab, entry: RecordingEntry) -> tuple[Recording, ...]:
    """Make one recording of a table, or one of each segment with a constant sampling rate.

    Raises ``UnitError``, ``RecordingError`` or ``LabFileError``. Minor problems (gaps, jitter,
    dead or clipped channels, rows without numbers) are in ``statements``.
    """
    return tuple(
        with_checks(ingest_table(part, lab, part_entry), lab)
        for part, part_entry in parts_of(table, lab, entry)
    )


def with_checks(recording: Recording, lab: Lab) -> Recording:
    """Return a recording with the statements of all checks, split at steps of the zero."""
    breaks, steps = find_baseline_steps(recording)
    new = record_in_counts((*check_recording(recording, lab), *steps), recording.counted)
    return replace(recording, breaks=breaks, statements=(*recording.statements, *new))


def parts_of(table: RawTable, lab: Lab, entry: RecordingEntry) -> tuple[Part, ...]:
    """Split a table where its sampling rate changes; each part becomes a recording.

    returned  table and entry of each recording: the name of a part ends in ``(part 1 of 3)``, and
              its start_s and stop_s count from its first sample
    """
    whole_table: tuple[Part, ...] = ((table, entry),)
    if table.independent or entry.sampling_rate_Hz is not None:
        return whole_table
    time = assign_columns(table, lab, entry).time
    if time is None:
        return whole_table
    time_s = time.values[::-1] if entry.reverse else time.values
    stamped = np.flatnonzero(np.isfinite(time_s))
    stamps_s = time_s[stamped]
    segments = constant_rate_segments(stamps_s)
    if len(segments) < 2:
        return whole_table
    if entry.reverse:
        table, entry = table.reversed(), structs.replace(entry, reverse=False)
    starts = [0, *(int(stamped[segment.start]) for segment in segments[1:])]
    locations = ", ".join(
        f"{table.row_name(row)} (t = {stamps_s[segment.start]:.6g} s)"
        for row, segment in zip(starts, segments, strict=True)
    )
    text = (
        f"The sampling rate changes: {len(segments)} segments begin at {locations}; each is "
        "read as a recording."
    )
    statement = finding("several_rates", text, place=table.row_name(starts[1]))
    # Start and stop of the entry count from the beginning of the table, later of the part.
    start_s = 0.0 if entry.start_s is None else entry.start_s
    stop_s = np.inf if entry.stop_s is None else entry.stop_s
    parts: list[Part] = []
    edges = pairwise((*starts, table.rows))
    for k, (segment, (start, stop)) in enumerate(zip(segments, edges, strict=True), 1):
        first_s, last_s = (stamps_s[[segment.start, segment.stop - 1]] - stamps_s[0]).tolist()
        if start_s >= last_s or stop_s <= first_s:
            continue
        shifted = structs.replace(
            entry,
            start_s=start_s - first_s if start_s > first_s else None,
            stop_s=stop_s - first_s if stop_s < last_s else None,
        )
        part = table.part(slice(start, stop), f"{table.name} (part {k} of {len(segments)})")
        part = replace(part, statements=(*part.statements, statement))
        parts.append((part, shifted))
    return tuple(parts) or whole_table


def ingest_table(table: RawTable, lab: Lab, entry: RecordingEntry) -> Recording:
    """Make a recording of a table, without the checks."""
    if table.independent and not entry.columns:
        raise RecordingError(
            f"{table.name}: a {table.format} table over {table.independent!r}, not over time",
            needed="columns as functions of time",
            remedy="Use it where a table is required (a tunnelling current against height), or "
            "name its columns and sampling_rate_Hz in lab.toml if they are samples in time.",
        )
    table = table.reversed() if entry.reverse else table
    assignment = assign_columns(table, lab, entry)
    table, rate_statements = select_common_rows(table, assignment)
    assignment = assign_columns(table, lab, entry) if rate_statements else assignment
    statements = [*table.statements, *assignment.statements, *rate_statements]
    unique = unique_rows(table, assignment, statements)
    complete, after_single, after_gap = complete_rows(table, assignment, unique, statements)
    clock = _clock(table, lab, entry, assignment, complete, unique)
    statements += clock.statements
    segments = positions_in(complete, np.array(table.segment_starts, dtype=int))
    bridged = set(clock.bridged)  # next to an incomplete row two samples are missing
    breaks = {*clock.breaks, *after_gap, *segments, *(bridged & after_single)}
    rows = SampleRows.of(complete, breaks, bridged | after_single)
    rows = rows.selected(entry, clock.sampling_rate_Hz)
    channels, invalid = _make_channels(table, assignment, rows, statements)
    quantities = {a.column.number: a.quantity for a in assignment.channels if a.quantity}
    reported = {(s.quantity, s.place) for s in statements}
    of_columns = check_columns(table, quantities)
    statements += [s for s in of_columns if (s.quantity, s.place) not in reported]
    axis = _select_axis(entry, channels, lab.place, statements)
    return Recording(
        name=table.name,
        digest=table.digest,
        axis=axis,
        sampling_rate_Hz=clock.sampling_rate_Hz,
        channels=channels,
        breaks=rows.breaks,
        bridged=tuple(sorted({*rows.bridged, *invalid})),
        statements=tuple(statements),
    )


def _make_channels(
    table: RawTable, assignment: Assignment, rows: SampleRows, statements: list[Statement]
) -> tuple[tuple[Channel, ...], list[int]]:
    """Return the channels, with invalid samples interpolated linearly, and the invalid samples.

    Appends a statement for each column and kind of invalid samples. Raises ``UnitError`` for a
    motion or voltage of impossible size.
    """
    columns = [a for a in assignment.channels if a.quantity is not None]
    values = [rows.values(a.column.values) for a in columns]  # in the file's units
    is_invalid = [np.zeros(len(rows.position), dtype=bool) for _ in columns]
    drive_of = {a.axis: k for k, a in enumerate(columns) if a.quantity is Quantity.VOLTAGE}
    row_name = table.row_names(rows.complete[rows.position.astype(np.intp)])
    for k, assigned in enumerate(columns):
        if assigned.quantity is not Quantity.DISPLACEMENT:
            continue
        drive, j = None, drive_of.get(assigned.axis)
        if j is not None:
            is_invalid[j] |= find_invalid_rows(values[k], values[j])
            drive = interpolate_invalid(values[j], is_invalid[j])
        for kind, samples in find_invalid_readings(values[k], drive):
            is_invalid[k][samples] = True
            statements.append(
                invalid_statement(
                    kind,
                    samples,
                    values[k],
                    is_invalid[k],
                    column=assigned.column.place,
                    unit=assigned.unit,
                    row_name=row_name,
                )
            )
    channels = tuple(
        Channel(
            quantity=assigned.quantity,
            axis=assigned.axis,
            values=interpolate_invalid(rows.values(assigned.values), mask),
            label=assigned.column.label or f"column {assigned.column.number}",
            is_counted=assigned.unit.is_counted and assigned.unit.dimension is Dimension.OTHER,
        )
        for assigned, mask in zip(columns, is_invalid, strict=True)
        if assigned.quantity is not None
    )
    _refuse_impossible_sizes(table.name, columns, channels)
    return channels, np.flatnonzero(np.any(is_invalid, axis=0)).tolist()


def _refuse_impossible_sizes(
    name: str, columns: Sequence[AssignedColumn], channels: Sequence[Channel]
) -> None:
    """Refuse a motion or voltage of impossible size, which indicates a wrong unit."""
    driven = {c.axis for c in channels if c.quantity is Quantity.VOLTAGE and np.ptp(c.values) > 0}
    for assigned, channel in zip(columns, channels, strict=True):
        low, high = _POSSIBLE.get(channel.quantity, (0.0, np.inf))
        size = float(np.ptp(channel.values))
        is_moved = channel.quantity is Quantity.VOLTAGE or channel.axis in driven
        if channel.is_counted or size == 0.0 or not (size > high or (size < low and is_moved)):
            continue
        usual = [
            unit
            for unit, factor in _LENGTHS_m.items()
            if channel.quantity is Quantity.DISPLACEMENT
            and _USUAL_m[0] <= size / assigned.unit.factor * factor <= _USUAL_m[1]
        ]
        unit = channel.quantity.value
        instead = f"In {' or '.join(usual)} it would be usual. " if usual else ""
        raise UnitError(
            f"{name}: {assigned.column.place} in {assigned.unit.symbol} goes over "
            f"{size:.3g} {unit}",
            needed=f"a range from {low:g} to {high:g} {unit}",
            remedy=f"{instead}Write its unit under units of its [[recording]] in lab.toml.",
        )


def _select_axis(
    entry: RecordingEntry, channels: Sequence[Channel], lab_file: str, statements: list[Statement]
) -> str:
    """Return the axis of a recording, and append a statement if there are several.

    The axis is that of the entry, else the one with a displacement and the largest drive.
    """
    axes = sorted({c.axis for c in channels})
    if entry.axis is not None:
        if entry.axis not in axes:
            raise LabFileError(
                f"{lab_file}: {entry.file} is declared as a recording of axis {entry.axis!r}, its "
                f"columns are of {', '.join(axes)}",
                needed="the axis of one of its columns",
                remedy="Correct the axis, or name the columns.",
            )
        return entry.axis
    displaced = {c.axis for c in channels if c.quantity is Quantity.DISPLACEMENT}
    ranges = {
        c.axis: float(np.ptp(c.values))
        for c in channels
        if c.quantity is Quantity.VOLTAGE and c.axis in displaced
    }
    if not ranges:
        return min(displaced or axes)
    axis = max(sorted(ranges), key=lambda name: ranges[name])
    if len(ranges) > 1:
        text = (
            f"Contains the axes {', '.join(sorted(ranges))}; read as {axis}, whose drive moves "
            "the most. Set axis in its [[recording]] of lab.toml to change this."
        )
        statements.append(finding("several_axes", text, place="columns"))
    return axis


def _clock(
    table: RawTable,
    lab: Lab,
    entry: RecordingEntry,
    assignment: Assignment,
    complete: Rows,
    unique: Rows,
) -> Clock:
    """Return the clock, its breaks and single losses as indices of complete rows.

    All rows with a stamp are read: a row without a number in another column is not a gap in time.
    A table without time column has the clock of its format, of its entry or of the laboratory.
    """
    if assignment.time is None:
        for column in clocks_of(table):  # an unused time column may also run backwards
            stamped = np.flatnonzero(np.isfinite(column.values))
            refuse_newest_first(column.si_values[stamped], table.name, table.row_names(stamped))
        file_rate_Hz = table.sampling_rate_Hz or entry.sampling_rate_Hz
        rate_Hz = file_rate_Hz or lab.acquisition.sampling_rate_Hz
        if rate_Hz is None:
            raise UnitError(
                f"{table.name}: no column is a time and the file states no sampling rate",
                needed="one of the two, to know when each row was recorded",
                remedy="Write the rate of this file into lab.toml, or name its time column. "
                "columns and units may be left out if the headings state them:\n\n"
                f"{entry_template(table)}\n",
            )
        clock, clock_Hz = stated_clock(rate_Hz, table.name), rate_Hz
        if file_rate_Hz is None:
            rounded_Hz = clock.sampling_rate_Hz
            text = (
                f"No time column: the file is read at {rounded_Hz:.9g} Hz, the rate of the "
                f"controller under [acquisition] of {lab.place}. To confirm this rate or to state "
                "another one, write sampling_rate_Hz = ... into the [[recording]] of this file."
            )
            statement = finding(CONTROLLER_RATE, text, value=rounded_Hz, unit="Hz")
            clock = replace(clock, statements=(statement,))
    else:
        stamped = unique[np.isfinite(assignment.time.values[unique])]
        stamps_s = assignment.time.values[stamped]
        clock = read_clock(stamps_s, table.name, table.row_names(stamped))
        clock = replace(
            clock,
            breaks=positions_in(complete, stamped[list(clock.breaks)]),
            bridged=positions_in(complete, stamped[list(clock.bridged)]),
        )
        clock_Hz = clock.sampling_rate_Hz
    declared_Hz = entry.sampling_rate_Hz
    if declared_Hz is not None and abs(declared_Hz - clock_Hz) > _RATE_TOLERANCE * clock_Hz:
        raise LabFileError(
            f"{lab.place}: sampling_rate_Hz of {table.name} is {declared_Hz:.9g} Hz, the file's "
            f"clock runs at {clock_Hz:.9g} Hz",
            needed="one rate, or no time column",
            remedy="Correct the rate or the unit of the time column.",
        )
    return clock
