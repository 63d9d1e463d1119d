"""Assign columns: quantity, axis and SI unit of each, from lab.toml or the headings.

An ambiguous file is refused, with its columns and with the lines of lab.toml that resolve the
ambiguity.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import LabFileError, UnitError
from piezoid.numerics.arrays import Array
from piezoid.records.column_refusals import (
    ambiguous_columns,
    clocks_of,
    missing_column,
    name_of,
    refuse_missing_units,
    stated_unit,
)
from piezoid.records.column_roles import DIMENSION_OF, Meaning, meaning_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.lab_tables import entry_text
from piezoid.records.recording import Quantity
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Dimension, Unit, unit_of
from piezoid.statement import Statement, finding

QUANTITIES = {quantity.name.lower(): quantity for quantity in Quantity}
_LOOP_QUANTITIES = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
# Counters that overflow: their bits, and their ticks if the column is in another unit.
_BITS, _TICKS_s = (16, 24, 32), (1e-3, 1e-6)
_MAX_MISS = 2.5  # intervals between a stamp at an overflow and the end of the counter

Meanings = list[tuple[Column, Meaning]]


@dataclass(frozen=True, kw_only=True, eq=False)
class AssignedColumn:
    """One column with its quantity, converted to SI units.

    quantity  None for the time column
    axis      empty for the time column
    unit      of the file's numbers, from the heading or lab.toml
    values    (rows,)  SI units, NaN for missing numbers; counts if they have no scale
    """

    column: Column
    quantity: Quantity | None
    axis: str
    unit: Unit
    values: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Assignment:
    """All columns that are read.

    time        None if the table has no time column
    channels    one per quantity and axis, in the order of the columns
    statements  assumed units, channels in counts, overflowing counters
    """

    time: AssignedColumn | None
    channels: tuple[AssignedColumn, ...]
    statements: tuple[Statement, ...]

    @property
    def columns(self) -> tuple[AssignedColumn, ...]:
        """Channels, then the time column if there is one."""
        return self.channels if self.time is None else (*self.channels, self.time)


def assign_columns(table: RawTable, lab: Lab, entry: RecordingEntry) -> Assignment:
    """Assign quantity, axis and SI unit to every column.

    Raises ``UnitError`` for a column without unit or axis and for two columns of one quantity and
    axis, with the lines to write into lab.toml; ``LabFileError`` if lab.toml names a column that
    the file does not have.
    """
    check_entry_names(lab, entry)
    if entry.columns:
        meanings = _declared_columns(table, lab, entry)
    else:
        meanings = [
            (column, meaning)
            for column in table.columns
            if np.isfinite(column.values).any() and (meaning := meaning_of(column.heading)).is_read
        ]
        # A column that is a drive or response only by its unit is ignored if another column is one
        # by its name: in ``voltage [V], position [um], Monitor [V]`` the monitor is not a drive.
        by_name = {(m.quantity, m.axis) for _, m in meanings if m.by_name}
        by_name |= {(quantity, None) for quantity, _ in by_name}
        meanings = [
            (column, m)
            for column, m in meanings
            if m.is_time or m.by_name or (m.quantity, m.axis) not in by_name
        ]
    clocks = [column for column, meaning in meanings if meaning.is_time]
    channels = _assign_axes(table, entry, [(c, m) for c, m in meanings if m.quantity])
    if len(clocks) > 1:
        locations = " and ".join(column.place for column in clocks)
        raise ambiguous_columns(table, f"{locations} are both a time")
    if not channels:
        raise ambiguous_columns(table, "no column is a drive voltage or a displacement")
    columns = [*((column, None, "") for column in clocks), *channels]
    refuse_missing_units(table, lab, entry, columns)
    statements: list[Statement] = []
    converted = [
        _convert_column(table, lab, entry, column, quantity, axis, statements)
        for column, quantity, axis in columns
    ]
    time = _unwrap_counter(table, converted[0], statements) if clocks else None
    return Assignment(
        time=time, channels=tuple(converted[len(clocks) :]), statements=tuple(statements)
    )


def _unwrap_counter(
    table: RawTable, time: AssignedColumn, statements: list[Statement]
) -> AssignedColumn:
    """Unwrap time stamps of a counter of 16, 24 or 32 bits.

        t_k <- t_k + 2^bits * tick * (overflows up to k)

    The tick is one unit of the column, a millisecond or a microsecond. The last stamp before an
    overflow must lie at the end of the counter and the next one at its beginning, 0 or the lowest
    signed number; otherwise the clock was set back.
    """
    stamped = np.flatnonzero(np.isfinite(time.values))
    steps_s = np.diff(time.values[stamped])
    backward = np.flatnonzero(steps_s < 0)
    interval_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    if not len(backward) or not interval_s > 0:
        return time
    last_s, first_s = time.values[stamped[backward]], time.values[stamped[backward + 1]]
    max_miss_s = _MAX_MISS * interval_s
    for tick_s, bits in itertools.product((time.unit.factor, *_TICKS_s), _BITS):
        period_s = 2.0**bits * tick_s
        continues = np.abs(steps_s[backward] + period_s - interval_s) < max_miss_s
        for low_s in (0.0, -period_s / 2):
            starts_low = np.abs(first_s - low_s) < max_miss_s
            ends_high = np.abs(last_s - low_s - period_s) < max_miss_s
            if (continues & starts_low & ends_high).all():
                rows = stamped[backward + 1]
                overflows_s = np.zeros(len(time.values))
                overflows_s[rows] = period_s
                location = table.row_name(int(rows[0]))
                text = (
                    f"The clock is a {bits}-bit counter that overflows {len(rows)} times, first "
                    f"at {location}."
                )
                statements.append(finding("wrapped_clock", text, place=location))
                return replace(time, values=time.values + np.cumsum(overflows_s))
    return time


def _declared_columns(table: RawTable, lab: Lab, entry: RecordingEntry) -> Meanings:
    """Return the columns that lab.toml names, and further columns identified by their headings.

    These are a time, and drives of other axes than that of the entry: they may move this axis.
    """
    meanings: dict[int, tuple[Column, Meaning]] = {}
    for key, name_or_number in entry.columns.items():
        column = table.find(name_or_number)
        if column is None or column.number in meanings:
            raise missing_column(table, lab, key, name_or_number)
        name, _, axis = key.partition("_")
        quantity = QUANTITIES.get(name)
        meaning = Meaning(
            is_time=quantity is None, quantity=quantity, axis=axis or None, by_name=True
        )
        meanings[column.number] = (column, meaning)
    if (
        "time" not in entry.columns
        and entry.sampling_rate_Hz is None
        and (clocks := clocks_of(table))
    ):
        meanings.setdefault(clocks[0].number, (clocks[0], Meaning(is_time=True)))
    if entry.axis is not None:
        declared_axes = {m.axis or entry.axis for _, m in meanings.values()}
        for column in table.columns:
            meaning, unit = meaning_of(column.heading), column.heading.unit
            if (
                meaning.quantity is Quantity.VOLTAGE
                and meaning.by_name
                and meaning.axis not in (None, *declared_axes)
                and unit is not None
                and unit.dimension is Dimension.VOLTAGE
                and np.isfinite(column.values).any()
            ):
                meanings.setdefault(column.number, (column, meaning))
    return list(meanings.values())


def check_entry_names(lab: Lab, entry: RecordingEntry) -> None:
    """Refuse names and units of a ``[[recording]]`` that no recording over time has."""
    for key in (*entry.columns, *entry.units, *entry.scale, *entry.offset):
        if key != "time" and key.partition("_")[0] not in QUANTITIES:
            raise LabFileError(
                f"{lab.place}: [[recording]] {entry.file!r} names {key!r}",
                needed=f"one of time, {', '.join(QUANTITIES)}, with an axis as in voltage_y",
                remedy="Correct the name.",
            )
    for key, symbol in entry.units.items():
        unit = unit_of(symbol)
        if unit is None or (unit.dimension is Dimension.OTHER and not unit.is_counted):
            raise LabFileError(
                f"{lab.place}: [[recording]] {entry.file!r}: the unit of {key} is {symbol!r}",
                needed="a unit of time, voltage, length, current, temperature or humidity",
                remedy="Write s, ms, V, mV, m, um, nm, A, nA, K, degC, %, counts or the like.",
            )


def _assign_axes(
    table: RawTable, entry: RecordingEntry, channels: Meanings
) -> list[tuple[Column, Quantity, str]]:
    """Return the channels with their axes; refuse duplicates and volts of unknown meaning."""
    parts = [(column, m.quantity, m.axis) for column, m in channels if m.quantity]
    has_response = any(quantity is Quantity.DISPLACEMENT for _, quantity, _ in parts)
    in_volts = [c for c, m in channels if m.quantity is Quantity.VOLTAGE and not m.by_name]
    if in_volts and not has_response:
        locations = " and ".join(column.place for column in in_volts)
        raise ambiguous_columns(table, f"{locations} in volts may be a drive or a sensor's output")
    # A column without an axis belongs to that of the entry, to the only axis of the file, or to x.
    named_axes = sorted({a for _, q, a in parts if a is not None and q in _LOOP_QUANTITIES})
    unnamed = [q for _, q, a in parts if a is None and q in _LOOP_QUANTITIES]
    with_axis = {q for _, q, a in parts if a is not None}
    default = "x"
    if entry.axis is not None:
        default = entry.axis
    elif len(named_axes) == 1 and not with_axis & set(unnamed):
        default = named_axes[0]
    elif len(named_axes) > 1 and unnamed and "x" in named_axes:
        kinds = ", ".join(quantity.name.lower() for quantity in unnamed)
        raise ambiguous_columns(
            table, f"the file names the axes {', '.join(named_axes)}, but not that of {kinds}"
        )
    columns: dict[tuple[Quantity, str], Column] = {}
    for column, quantity, axis in parts:
        key = (quantity, axis or default)
        if key in columns:
            raise ambiguous_columns(
                table,
                f"{columns[key].place} and {column.place} both claim to be the "
                f"{quantity.name.lower()} of {key[1]}",
            )
        columns[key] = column
    return [(column, quantity, axis) for (quantity, axis), column in columns.items()]


def _convert_column(
    table: RawTable,
    lab: Lab,
    entry: RecordingEntry,
    column: Column,
    quantity: Quantity | None,
    axis: str,
    statements: list[Statement],
) -> AssignedColumn:
    """Convert a column to SI units, volts of a sensor by the sensor's gain.

    Appends assumptions to ``statements``. Raises ``UnitError`` for a column without unit, in a
    unit of another quantity, or in volts of a sensor of unknown gain.
    """
    name, unit = name_of(quantity), stated_unit(entry, column, quantity, axis)
    if unit is None and quantity is Quantity.VOLTAGE:
        unit = Unit(symbol="V", dimension=Dimension.VOLTAGE)
        text = f"{column.place} has no unit; the voltage that lab.toml names is read as volts."
        statements.append(finding("unit_assumed", text, place=column.place))
    written = column.heading.unit
    if unit and written and written.dimension is unit.dimension and written.factor != unit.factor:
        text = (
            f"{column.place} states {written.symbol} in its heading, lab.toml {unit.symbol}, "
            "which is used. Correct the wrong one."
        )
        statements.append(finding("unit_contradicts_heading", text, place=column.place))
    # Only the shape of a reference is used.
    unit = unit or Unit(symbol="", dimension=Dimension.OTHER)
    values = column.values * unit.factor + unit.offset
    expected = Dimension.TIME if quantity is None else DIMENSION_OF.get(quantity)
    is_displacement_of_drive = (
        quantity is Quantity.VOLTAGE and unit.dimension is Dimension.LENGTH and not unit.is_counted
    )
    scale = entry.scale.get(f"{name}_{axis}", entry.scale.get(name))
    if unit.is_counted and quantity is not Quantity.REFERENCE and scale is None:
        statements.append(_counts_statement(table, lab, column, quantity, axis))
    elif quantity is Quantity.DISPLACEMENT and unit.dimension is Dimension.VOLTAGE:
        values = values / sensor_gain_V_per_m(
            lab,
            axis,
            f"{table.name}: {column.place} is a displacement of axis {axis} in volts",
            needed="metres",
        )
    elif is_displacement_of_drive and scale is None:
        raise UnitError(
            f"{table.name}: {column.place} is a drive of axis {axis} in {unit.symbol}: volts "
            "times a sensitivity, as microscope programs write it",
            needed="the drive in volts, or how many volts one metre of it is",
            remedy="Write into its [[recording]] of lab.toml:\n\nscale = { voltage = ... }\n",
        )
    elif unit.dimension is not expected and not (
        unit.is_counted or is_displacement_of_drive or quantity is Quantity.REFERENCE
    ):
        raise ambiguous_columns(table, f"{column.place} is a {name} by name but in {unit.symbol}")
    offset = entry.offset.get(f"{name}_{axis}", entry.offset.get(name))
    if scale is not None or offset is not None:
        values = values * (1.0 if scale is None else scale) + (offset or 0.0)
        if unit.is_counted and quantity in DIMENSION_OF:
            unit = replace(unit, dimension=DIMENSION_OF[quantity])
    return AssignedColumn(column=column, quantity=quantity, axis=axis, unit=unit, values=values)


def sensor_gain_V_per_m(lab: Lab, axis: str, volts: str, *, needed: str) -> float:
    """Return the gain of a sensor; without one refuse the column that ``volts`` describes."""
    gain_V_per_m = lab.sensor_of(axis).gain_V_per_m
    if gain_V_per_m is None:
        raise UnitError(
            volts,
            needed=f"the sensor's gain, to convert it to {needed}",
            remedy="Write into lab.toml:\n\n[sensor]\ngain_V_per_m = ...\n",
        )
    return gain_V_per_m


def _counts_statement(
    table: RawTable, lab: Lab, column: Column, quantity: Quantity | None, axis: str
) -> Statement:
    """Return the statement that a drive or displacement stays in counts, with a scale if possible.

    Raises ``UnitError`` for any other quantity in counts.
    """
    name = "time" if quantity is None else quantity.name.lower()
    if quantity not in _LOOP_QUANTITIES or quantity is None:
        si = "s" if quantity is None else quantity.value
        raise UnitError(
            f"{table.name}: {column.place} is a {name} in counts",
            needed=f"how many {si} one count is: only drive and displacement may be in counts",
            remedy="Write into lab.toml:\n\n"
            f"{entry_text(table.name, f'scale = {{ {name} = ... }}')}\n",
        )
    # The declared converter gives the size of a count.
    acquisition, range_V = lab.acquisition, lab.acquisition.input_range_V
    is_drive = quantity is Quantity.VOLTAGE
    bits = acquisition.dac_bits if is_drive else acquisition.adc_bits
    gain_V_per_m = 1.0 if is_drive else lab.sensor_of(axis).gain_V_per_m
    size, source = "...", ""
    if range_V is not None and bits is not None and gain_V_per_m is not None:
        span_V = range_V[1] - range_V[0]
        size = f"{span_V / 2**bits / gain_V_per_m:.9g}"
        source = (
            f" (if the {span_V:g} V of input_range_V are the {bits} bits of the converter); "
            f"offset = {{ {name} = ... }} adds the {quantity.value} of count 0"
        )
    text = (
        f"{column.place} is a {name} in counts; results are stated in counts, and no controller "
        f"is exported. To change this, write scale = {{ {name} = {size} }}, {quantity.value} per "
        f"count, into its [[recording]] of lab.toml{source}."
    )
    return finding("counts", text, place=column.place)
