"""Inspection: what was understood of a file, whether or not it can become a recording."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piezoid.errors import PiezoidError
from piezoid.numerics.arrays import Array
from piezoid.records.checks import check_set
from piezoid.records.checks.columns import check_columns
from piezoid.records.column_roles import Meaning, Role, meaning_of
from piezoid.records.columns import Assignment, assign_columns
from piezoid.records.ingest import ingest_table, parts_of, with_checks
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.readers import is_approach_curve, read_table
from piezoid.records.recording import Quantity, Recording
from piezoid.records.response_columns import is_response, part_of, response_columns
from piezoid.records.response_ingest import ingest_response
from piezoid.records.response_summary import ResponseSummary, summary_of
from piezoid.records.response_units import unit_in_heading
from piezoid.records.reversals import noise_of, reversals_of
from piezoid.records.sample_statistics import clipped_share, is_dead, noise_rms, step_size
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

# A turn of the drive smaller than this share of its span is no sweep.
_TURN_SHARE = 0.01
# Turning points closer than this share of the span are one level of the drive.
_LEVEL_SHARE = 0.02
_WIDE = 5.0  # times
_MOST_LEVELS = 12


@dataclass(frozen=True, kw_only=True)
class ColumnSummary:
    """One column, for people.

    number     its place in the file
    label      its heading as found
    meaning    ``time``, ``voltage of x``, or ``not read: ...`` with the reason
    unit       as found, empty where none was
    si_unit    of the numbers below, empty where none is known
    minimum, maximum   of the numbers it holds; None where it holds none
    noise_rms  robust white noise; None where there are too few samples
    step       the smallest step of its values, 0 where there is none
    is_dead    it never changes
    clipped    share of samples resting on an extreme
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
    """All that was understood of one file.

    name              the file's name
    digest, format    None where it could not be read at all
    rows, columns     of its table
    axis              of the recording, None where it is refused
    axis_is_named     whether a heading or lab.toml says so; it is called x here otherwise
    sampling_rate_Hz, duration_s, breaks, reversals, levels_V
                      of the recording; levels are the voltages the drive turns at
    counted           what is in counts of a converter, of ``displacement`` and ``voltage``
    response          of a frequency response, which has no rate and no duration
    statements          everything odd, each with its place
    refusal           why it is no recording, None where it is one
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


def inspect_file(path: Path, lab: Lab | None = None) -> tuple[Inspection, ...]:
    """Inspect one file: one inspection for each ``[[recording]]`` entry about it, or just one.

    A file that cannot be used is an inspection with a refusal, so that inspecting ten shows ten.
    """
    return tuple(inspection for inspection, _ in _inspected(path, lab or Lab()))


def inspect_files(paths: Iterable[Path], lab: Lab | None = None) -> tuple[Inspection, ...]:
    """Inspect several files, and say which of them do not fit the others.

    Raises ``LabFileError`` for an entry about a file that is nowhere.
    """
    paths, lab = tuple(paths), lab or Lab()
    lab.check_files(paths)
    inspected = [pair for path in paths for pair in _inspected(path, lab)]
    recordings = [recording for _, recording in inspected if recording is not None]
    statements = check_set(recordings)
    return tuple(
        replace(
            inspection,
            statements=(
                *inspection.statements,
                *(
                    s
                    for s in statements
                    if recording is not None and s.recording == recording.name
                ),
            ),
        )
        for inspection, recording in inspected
    )


def _inspected(path: Path, lab: Lab) -> list[tuple[Inspection, Recording | None]]:
    try:
        table = read_table(path, lab.text_format_of(path))
    except PiezoidError as error:
        return [(Inspection(name=path.name, refusal=str(error)), None)]
    inspected: list[tuple[Inspection, Recording | None]] = []
    for entry in lab.entries_of(path) or (None,):
        if is_response(table, entry):
            inspected.append((_inspect_response(table, lab, entry), None))
        else:
            inspected += [_inspect_table(*part) for part in _parts(table, lab, entry)]
    return inspected


def _inspect_response(table: RawTable, lab: Lab, entry: RecordingEntry | None) -> Inspection:
    try:
        response = ingest_response(table, lab, entry)
    except PiezoidError as error:
        by_name = {c.number: f"{part}, by its name" for c in table.columns if (part := part_of(c))}
        refused = _refused(table, error)
        return replace(
            refused,
            columns=tuple(_response_column(c, by_name.get(c.number)) for c in table.columns),
        )
    columns = response_columns(table, lab, entry or RecordingEntry(file=table.name))
    parts = {columns.frequency.number: "frequency"}
    for (output, drive), part_columns in columns.paths.items():
        to = "" if output == drive else f" to a drive of {drive}"
        parts |= {
            column.number: f"{part} of {output}{to}" for part, column in part_columns.items()
        }
    return Inspection(
        name=table.name,
        digest=table.digest,
        format=table.format,
        rows=table.rows,
        columns=tuple(
            _response_column(column, parts.get(column.number)) for column in table.columns
        ),
        axis_is_named=response.axis_is_named,
        response=summary_of(response),
        statements=response.statements,
    )


def _response_column(column: Column, part: str | None) -> ColumnSummary:
    """Summarise a column of a frequency response, the numbers as found: rows are no samples."""
    unit = unit_in_heading(column)
    meaning = part or "not read: no part of the response"
    summary = _numbers(column, column.values, meaning=meaning, unit="", si_unit="")
    symbol = "" if unit is None else unit.symbol
    return replace(summary, unit=symbol, si_unit=symbol, noise_rms=None, step=0.0, clipped=0.0)


def _parts(
    table: RawTable, lab: Lab, entry: RecordingEntry | None
) -> tuple[tuple[RawTable, Lab, RecordingEntry | None], ...]:
    try:
        return parts_of(table, lab, entry)
    except PiezoidError:  # which reading the whole says as well
        return ((table, lab, entry),)


def _inspect_table(
    table: RawTable, lab: Lab, entry: RecordingEntry | None
) -> tuple[Inspection, Recording | None]:
    try:
        recording = with_checks(ingest_table(table, lab, entry), lab)
    except PiezoidError as error:
        refused = _refused(table, error)
        is_named = entry is not None and entry.columns
        is_curve = is_approach_curve(table) and not is_named
        return (_approach_curve(table, refused) if is_curve else refused), None
    entry = RecordingEntry(file=table.name) if entry is None else entry
    assignment = assign_columns(table, lab, entry)
    drive = recording.find(Quantity.VOLTAGE, recording.axis)
    reversals = None if drive is None else _turns(recording, drive.values)
    inspection = Inspection(
        name=table.name,
        digest=table.digest,
        format=table.format,
        rows=table.rows,
        columns=tuple(_read_summary(column, assignment) for column in table.columns),
        axis=recording.axis,
        axis_is_named=_is_axis_named(assignment, entry),
        sampling_rate_Hz=recording.sampling_rate_Hz,
        duration_s=recording.duration_s,
        breaks=len(recording.breaks),
        reversals=None if reversals is None else len(reversals),
        levels_V=() if drive is None or not reversals else _levels(drive.values, reversals),
        counted=recording.counted,
        statements=recording.statements,
    )
    return inspection, recording


def _approach_curve(table: RawTable, refused: Inspection) -> Inspection:
    """Return the inspection of a table over a height: its currents tell the tunnelling barrier."""
    text = (
        f"a table over the height {table.independent!r}, without a time: fit takes its currents "
        "for approach curves of the tunnelling junction"
    )
    statement = finding(quantity="approach_curve", place=table.independent, text=text)
    return replace(refused, refusal=None, statements=(statement, *refused.statements))


def _refused(table: RawTable, error: PiezoidError) -> Inspection:
    return Inspection(
        name=table.name,
        digest=table.digest,
        format=table.format,
        rows=table.rows,
        columns=tuple(_summary(column, meaning_of(column.heading)) for column in table.columns),
        sampling_rate_Hz=table.sampling_rate_Hz,
        statements=(*table.statements, *check_columns(table, {})),
        refusal=str(error),
    )


def _is_axis_named(assignment: Assignment, entry: RecordingEntry) -> bool:
    headings = (meaning_of(channel.column.heading) for channel in assignment.channels)
    return (
        entry.axis is not None
        or any("_" in key for key in entry.columns)
        or any(meaning.axis is not None for meaning in headings)
    )


def _read_summary(column: Column, assignment: Assignment) -> ColumnSummary:
    """Summarise a column by what the recording made of it, lab.toml included."""
    for assigned in assignment.columns:
        if assigned.column is column:
            quantity = assigned.quantity
            return _numbers(
                column,
                assigned.values,
                meaning=f"{quantity.name.lower()} of {assigned.axis}" if quantity else "time",
                unit=assigned.unit.symbol,
                si_unit=assigned.unit.si_symbol,
            )
    meaning = meaning_of(column.heading)
    if meaning.role is not Role.UNREAD:
        meaning = Meaning(role=Role.UNREAD, reason="another column was taken for this part")
    return _summary(column, meaning)


def _summary(column: Column, meaning: Meaning) -> ColumnSummary:
    unit = column.heading.unit
    return _numbers(
        column,
        column.si_values,
        meaning=_sentence(meaning),
        unit="" if unit is None else unit.symbol,
        si_unit="" if unit is None else unit.si_symbol,
    )


def _sentence(meaning: Meaning) -> str:
    if meaning.role is Role.CHANNEL and meaning.quantity is not None:
        name = meaning.quantity.name.lower()
        return f"{name} of {meaning.axis}" if meaning.axis else name
    return f"not read: {meaning.reason}" if meaning.reason else meaning.role.value


def _numbers(
    column: Column, values: Array, *, meaning: str, unit: str, si_unit: str
) -> ColumnSummary:
    numbers = values[np.isfinite(values)]
    return ColumnSummary(
        number=column.number,
        label=column.label,
        meaning=meaning,
        unit=unit,
        si_unit=si_unit,
        minimum=float(numbers.min()) if len(numbers) else None,
        maximum=float(numbers.max()) if len(numbers) else None,
        noise_rms=noise_rms(numbers) if len(numbers) > 4 else None,
        step=step_size(numbers) if len(numbers) else 0.0,
        is_dead=bool(len(numbers)) and is_dead(numbers),
        clipped=clipped_share(numbers, rest=0.0 if si_unit == "V" else None)
        if len(numbers)
        else 0.0,
        missing=int(np.count_nonzero(~np.isfinite(column.values))),
    )


def _turns(recording: Recording, voltage_V: Array) -> list[int]:
    """Return the reversals of the drive in all pieces, ignoring noise and small turns."""
    ignored_V = max(_TURN_SHARE * float(np.ptp(voltage_V)), noise_of(voltage_V))
    turns = []
    for piece in recording.pieces:
        turns += [piece.start + k for k in reversals_of(voltage_V[piece], ignored_V)]
    return turns


def _levels(voltage_V: Array, reversals: list[int]) -> tuple[float, ...]:
    """Return the distinct voltages the drive turns at, ascending; none where they are too many."""
    turns = np.sort(voltage_V[reversals])
    edges = np.flatnonzero(np.diff(turns) > _LEVEL_SHARE * float(np.ptp(voltage_V))) + 1
    groups = np.split(turns, edges)
    # a group many times wider than two levels are apart is no level: turns lie everywhere in it
    is_wide = any(np.ptp(g) > _WIDE * _LEVEL_SHARE * np.ptp(voltage_V) for g in groups)
    return () if is_wide or len(groups) > _MOST_LEVELS else tuple(float(g.mean()) for g in groups)
