"""Inspection: summary of a file, whether or not it can become a recording."""

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piezoid.errors import PiezoidError
from piezoid.numerics.arrays import Array
from piezoid.records.checks import check_set
from piezoid.records.checks.columns import check_columns
from piezoid.records.column_refusals import with_axis
from piezoid.records.column_roles import meaning_of
from piezoid.records.columns import Assignment, assign_columns
from piezoid.records.drive_scope import scope_statements
from piezoid.records.drive_signal import noise_of, reversals_of
from piezoid.records.frequency_response import ResponseSummary, summary_of
from piezoid.records.ingest import Part, ingest_table, parts_of, with_checks
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import is_approach_curve, read_table
from piezoid.records.recording import Quantity, Recording
from piezoid.records.response_columns import (
    is_response,
    part_of,
    response_columns,
    unit_in_heading,
)
from piezoid.records.response_ingest import ingest_response
from piezoid.records.sample_statistics import (
    clipped_samples,
    is_noise_hidden,
    noise_rms,
    step_size,
)
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

# Of the range of the drive: smaller turns are ignored.
_TURN_SHARE = 0.01
# Turning points closer than this share of the range are one level of the drive; if a group is five
# times as wide, they are spread continuously.
_LEVEL_SHARE, _WIDE = 0.02, 5.0
_MAX_LEVELS = 12


@dataclass(frozen=True, kw_only=True)
class ColumnSummary:
    """Summary of one column.

    number     index in the file, from 1
    label      heading in the file
    meaning    ``time``, ``voltage of x``, or ``not read: ...`` with the reason
    unit       as written in the file, empty without one
    si_unit    of the numbers below, empty if unknown
    minimum, maximum   of its numbers; None without numbers
    noise_rms  robust white noise; None for too few samples or a too fast signal
    step       smallest step of its values, 0 without one
    is_dead    whether it is constant
    clipped    share of the samples at an extreme
    missing    number of rows without a number
    """

    number: int
    label: str
    meaning: str
    unit: str
    si_unit: str
    minimum: float | None
    maximum: float | None
    noise_rms: float | None
    step: float
    is_dead: bool
    clipped: float
    missing: int


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """Interpretation of one file.

    name              the file's name
    digest, format    None if the file could not be read
    rows, columns     of its table
    axis              of the recording, None if it is refused
    axis_is_named     whether a heading or lab.toml names the axis; otherwise it is x
    sampling_rate_Hz, duration_s, breaks, reversals, levels_V
                      of the recording; the drive turns at the voltages levels_V
    counted           quantities in counts of a converter, of ``displacement`` and ``voltage``
    response          summary of a frequency response, which has no rate and no duration
    statements        all problems of the file, each with its place
    refusal           why the file is refused, None if it is read
    """

    name: str
    digest: str | None = None
    format: str | None = None
    rows: int = 0
    columns: tuple[ColumnSummary, ...] = ()
    axis: str | None = None
    axis_is_named: bool = True
    sampling_rate_Hz: float | None = None
    duration_s: float | None = None
    breaks: int = 0
    reversals: int | None = None
    levels_V: tuple[float, ...] = ()
    counted: tuple[str, ...] = ()
    response: ResponseSummary | None = None
    statements: tuple[Statement, ...] = ()
    refusal: str | None = None


def inspect_files(paths: Iterable[Path], lab: Lab | None = None) -> tuple[Inspection, ...]:
    """Inspect files, separately and for consistency with each other.

    Each file has an inspection for every ``[[recording]]`` entry about it, or a single one. The
    inspection of an unusable file contains a refusal.

    Raises ``LabFileError`` for an entry about a file that does not exist.
    """
    paths, lab = tuple(paths), lab or Lab()
    lab.check_files(paths)
    inspected: list[tuple[Inspection, Recording | None]] = []
    for path in paths:
        try:
            table = read_table(path, lab.text_format_of(path))
        except PiezoidError as error:
            inspected.append((Inspection(name=path.name, refusal=str(error)), None))
            continue
        for entry in lab.entries_of(path) or (RecordingEntry(file=path.name),):
            if is_response(table, entry):
                inspected.append((_inspect_response(table, lab, entry), None))
                continue
            parts: tuple[Part, ...] = ((table, entry),)
            with contextlib.suppress(PiezoidError):  # _inspect_table reports the same error
                parts = parts_of(table, lab, entry)
            inspected += [_inspect_table(part, lab, part_entry) for part, part_entry in parts]
    recordings = [recording for _, recording in inspected if recording is not None]
    statements = [*check_set(recordings), *scope_statements(recordings)]
    inspections, axes = [], [recording.axis for recording in recordings]
    for inspection, recording in inspected:
        name = None if recording is None else recording.name
        further = (s for s in statements if s.recording == name)
        refusal = inspection.refusal and with_axis(inspection.refusal, axes)
        inspections.append(
            replace(inspection, statements=(*inspection.statements, *further), refusal=refusal)
        )
    return tuple(inspections)


def _table_summary(table: RawTable) -> Inspection:
    """Return the entries of an inspection that every table has."""
    return Inspection(
        name=table.name,
        digest=table.digest,
        format=table.format,
        rows=table.rows,
        sampling_rate_Hz=table.sampling_rate_Hz,
    )


def _inspect_response(table: RawTable, lab: Lab, entry: RecordingEntry) -> Inspection:
    """Inspect a frequency response; its columns are summarised in the units of the file."""
    meanings: dict[int, str] = {}
    try:
        response = ingest_response(table, lab, entry)
    except PiezoidError as error:
        meanings = {
            c.number: f"{part}, by its name" for c in table.columns if (part := part_of(c))
        }
        inspection = replace(
            _table_summary(table),
            statements=(*table.statements, *check_columns(table, {})),
            refusal=str(error),
        )
    else:
        columns = response_columns(table, lab, entry)
        meanings[columns.frequency.number] = "frequency"
        for (output, drive), parts in columns.paths.items():
            to = "" if output == drive else f" to a drive of {drive}"
            meanings |= {c.number: f"{part} of {output}{to}" for part, c in parts.items()}
        inspection = replace(
            _table_summary(table),
            sampling_rate_Hz=None,
            axis_is_named=response.axis_is_named,
            response=summary_of(response),
            statements=response.statements,
        )
    summaries = []
    for column in table.columns:
        unit = unit_in_heading(column)
        symbol = "" if unit is None else unit.symbol
        meaning = meanings.get(column.number, "not read: no part of the response")
        summary = _summarise(column, column.values, meaning, symbol, symbol)
        summaries.append(replace(summary, noise_rms=None, step=0.0, clipped=0.0))
    return replace(inspection, columns=tuple(summaries))


def _inspect_table(
    table: RawTable, lab: Lab, entry: RecordingEntry
) -> tuple[Inspection, Recording | None]:
    try:
        recording = with_checks(ingest_table(table, lab, entry), lab)
        assignment = assign_columns(table, lab, entry)
    except PiezoidError as error:
        declared = {c.number: k for k, v in entry.columns.items() if (c := table.find(v))}
        summaries = [_summarise_column(column, None) for column in table.columns]
        refused = replace(
            _table_summary(table),
            columns=tuple(
                replace(s, meaning=f"{declared[s.number]}, named in lab.toml")
                if s.number in declared
                else s
                for s in summaries
            ),
            statements=(*table.statements, *check_columns(table, {})),
            refusal=str(error),
        )
        if entry.columns or not is_approach_curve(table):
            return refused, None
        text = (
            f"a table over the height {table.independent!r}, without a time: fit uses its "
            "currents as approach curves of the tunnelling junction"
        )
        curve = finding("approach_curve", text, place=table.independent)
        return replace(refused, refusal=None, statements=(curve, *refused.statements)), None
    # The drive turns at a few levels, or its turns are spread continuously.
    reversals: int | None = None
    levels_V: tuple[float, ...] = ()
    drive = recording.find(Quantity.VOLTAGE, recording.axis)
    if drive is not None:
        drive_V, range_V = drive.values, float(np.ptp(drive.values))
        ignored_V = max(_TURN_SHARE * range_V, noise_of(drive_V))
        turns = [drive_V[p][list(reversals_of(drive_V[p], ignored_V))] for p in recording.pieces]
        turns_V = np.sort(np.concatenate(turns))
        reversals = len(turns_V)
        gaps = np.flatnonzero(np.diff(turns_V) > _LEVEL_SHARE * range_V)
        groups = np.split(turns_V, gaps + 1) if reversals else []
        is_wide = any(np.ptp(group) > _WIDE * _LEVEL_SHARE * range_V for group in groups)
        if not is_wide and len(groups) <= _MAX_LEVELS:
            levels_V = tuple(float(group.mean()) for group in groups)
    headings = [meaning_of(channel.column.heading) for channel in assignment.channels]
    inspection = replace(
        _table_summary(table),
        columns=tuple(_summarise_column(column, assignment) for column in table.columns),
        axis=recording.axis,
        axis_is_named=entry.axis is not None
        or any("_" in key for key in entry.columns)
        or any(meaning.axis is not None for meaning in headings),
        sampling_rate_Hz=recording.sampling_rate_Hz,
        duration_s=recording.duration_s,
        breaks=len(recording.breaks),
        reversals=reversals,
        levels_V=levels_V,
        counted=recording.counted,
        statements=recording.statements,
    )
    return inspection, recording


def _summarise_column(column: Column, assignment: Assignment | None) -> ColumnSummary:
    """Summarise a column as assigned in the recording, or by its heading if it is not read."""
    for assigned in () if assignment is None else assignment.columns:
        if assigned.column is column:
            quantity, unit = assigned.quantity, assigned.unit
            meaning = "time" if quantity is None else f"{quantity.name.lower()} of {assigned.axis}"
            return _summarise(column, assigned.values, meaning, unit.symbol, unit.si_symbol)
    heading = meaning_of(column.heading)
    if assignment is not None and heading.is_read:
        meaning = "not read: another column is used"
    elif heading.quantity is not None:
        meaning = heading.quantity.name.lower() + (f" of {heading.axis}" if heading.axis else "")
    else:
        meaning = f"not read: {heading.reason}" if heading.reason else "time"
    in_heading = column.heading.unit
    symbol, si = ("", "") if in_heading is None else (in_heading.symbol, in_heading.si_symbol)
    return _summarise(column, column.si_values, meaning, symbol, si)


def _summarise(
    column: Column, values: Array, meaning: str, unit: str, si_unit: str
) -> ColumnSummary:
    numbers = values[np.isfinite(values)]
    is_empty = not len(numbers)
    is_noise_unknown = len(numbers) < 5 or is_noise_hidden(numbers)
    is_clipped = clipped_samples(numbers, idle_value=0.0 if si_unit == "V" else None)
    return ColumnSummary(
        number=column.number,
        label=column.label,
        meaning=meaning,
        unit=unit,
        si_unit=si_unit,
        minimum=None if is_empty else float(numbers.min()),
        maximum=None if is_empty else float(numbers.max()),
        noise_rms=None if is_noise_unknown else noise_rms(numbers),
        step=0.0 if is_empty else step_size(numbers),
        is_dead=not is_empty and bool(np.ptp(numbers) == 0),
        clipped=0.0 if is_empty else float(is_clipped.mean()),
        missing=int(np.count_nonzero(~np.isfinite(column.values))),
    )
