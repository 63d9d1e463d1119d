"""One column in SI units: by the unit of its heading or of lab.toml; volts of a sensor by gain."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

from piezoid.errors import UnitError
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.meaning import DIMENSION_OF
from piezoid.records.recording import Quantity
from piezoid.records.refusal import refuse
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Dimension, Unit, unit_of
from piezoid.statement import Statement, finding


@dataclass(frozen=True, kw_only=True, eq=False)
class Assigned:
    """One column with its part in the recording.

    quantity  None for the time column
    axis      empty for the time column
    unit      it was converted from, of the heading or of lab.toml
    values    (rows,)  SI units, NaN kept; counts where the unit is counted and has no scale
    """

    column: Column
    quantity: Quantity | None
    axis: str
    unit: Unit
    values: Array


def converted(
    table: RawTable,
    lab: Lab,
    entry: RecordingEntry,
    column: Column,
    quantity: Quantity | None,
    axis: str,
) -> tuple[Assigned, tuple[Statement, ...]]:
    """Convert a column to SI units, volts of a sensor by the sensor's gain.

    quantity, axis  None and empty for a time
    returned        the column, and what was taken to be so and is told

    Raises ``UnitError`` for a column without unit, in one of something else, or in volts of a
    sensor whose gain is not known.
    """
    unit = _unit_for(entry, column, quantity, axis)
    if quantity is Quantity.REFERENCE:
        return _scaled(entry, _as_recorded(column, quantity, axis, unit)), ()
    wanted = Dimension.TIME if quantity is None else DIMENSION_OF[quantity]
    statements: tuple[Statement, ...] = ()
    if unit is None and quantity is Quantity.VOLTAGE and entry.columns:
        unit = Unit(symbol="V", dimension=Dimension.VOLTAGE)
        text = f"{column.place} has no unit; a voltage that lab.toml names is taken to be in volts"
        statements = (finding(quantity="unit_assumed", place=column.place, text=text),)
    if unit is None:
        raise refuse(table, f"{column.place} is a {_name_of(quantity)} without a unit")
    values = column.values * unit.factor + unit.offset
    if unit.is_counted:
        if _said(entry.scale, quantity, axis) is None:
            statements = (*statements, _in_counts(table, lab, column, quantity, axis))
    elif quantity is Quantity.DISPLACEMENT and unit.dimension is Dimension.VOLTAGE:
        gain_V_per_m = lab.sensor_of(axis).gain_V_per_m
        if gain_V_per_m is None:
            raise UnitError(
                f"{table.name}: {column.place} is a displacement of axis {axis} in volts",
                needed="the sensor's gain, to know it in metres",
                remedy="Write into lab.toml:\n\n[sensor]\ngain_V_per_m = ...\n",
            )
        values = values / gain_V_per_m
    elif quantity is Quantity.VOLTAGE and unit.dimension is Dimension.LENGTH:
        _check_nominal(table, entry, column, unit, axis)
    elif unit.dimension is not wanted:
        raise refuse(
            table, f"{column.place} is a {_name_of(quantity)} by name but in {unit.symbol}"
        )
    assigned = Assigned(column=column, quantity=quantity, axis=axis, unit=unit, values=values)
    return _scaled(entry, assigned), statements


def _check_nominal(
    table: RawTable, entry: RecordingEntry, column: Column, unit: Unit, axis: str
) -> None:
    """Refuse a drive that a program tells as a height, unless its volts per metre are said."""
    if _said(entry.scale, Quantity.VOLTAGE, axis) is None:
        raise UnitError(
            f"{table.name}: {column.place} is a drive of axis {axis} in {unit.symbol}: volts "
            "times a sensitivity, as programs of microscopes tell it",
            needed="the drive in volts, or how many volts one metre of it is",
            remedy="Write into its [[recording]] of lab.toml:\n\nscale = { voltage = ... }\n",
        )


def _in_counts(
    table: RawTable, lab: Lab, column: Column, quantity: Quantity | None, axis: str
) -> Statement:
    """Return what counts without a scale come to, and the scale where lab.toml tells it.

    Raises ``UnitError`` for what may not be in counts.
    """
    name = _name_of(quantity)
    if quantity not in (Quantity.VOLTAGE, Quantity.DISPLACEMENT):
        si = "s" if quantity is None else quantity.value
        raise UnitError(
            f"{table.name}: {column.place} is a {name} in counts",
            needed=f"how many {si} one count is: only drive and displacement may be in counts",
            remedy=f"Write into lab.toml:\n\n[[recording]]\nfile = {json.dumps(table.name)}\n"
            f"scale = {{ {name} = ... }}\n",
        )
    example, because = _step_of(lab, quantity, axis)
    text = (
        f"{column.place} is a {name} in counts, and stays in them: everything about it is told in "
        "counts, and nothing that depends on it can be shipped. Once it is known how many "
        f"{quantity.value} one count is, write scale = {{ {name} = {example} }} into its "
        f"[[recording]] of lab.toml{because}"
    )
    return finding(quantity="counts", place=column.place, text=text)


def _step_of(lab: Lab, quantity: Quantity, axis: str) -> tuple[str, str]:
    """Return the size of a count where lab.toml tells it, and by what."""
    acquisition, range_V = lab.acquisition, lab.acquisition.input_range_V
    is_drive = quantity is Quantity.VOLTAGE
    bits = acquisition.dac_bits if is_drive else acquisition.adc_bits
    gain_V_per_m = 1.0 if is_drive else lab.sensor_of(axis).gain_V_per_m
    if range_V is None or bits is None or gain_V_per_m is None:
        return "...", ""
    span_V = range_V[1] - range_V[0]
    name = _name_of(quantity)
    return (
        f"{span_V / 2**bits / gain_V_per_m:.9g}",
        f", if the {span_V:g} V of input_range_V are the {bits} bits of the converter; "
        f"offset = {{ {name} = ... }} adds the {quantity.value} of count 0",
    )


def _scaled(entry: RecordingEntry, assigned: Assigned) -> Assigned:
    """Return a column times the scale and plus the offset of its entry."""
    scale = _said(entry.scale, assigned.quantity, assigned.axis)
    offset = _said(entry.offset, assigned.quantity, assigned.axis)
    if scale is None and offset is None:
        return assigned
    factor = 1.0 if scale is None else scale
    unit = assigned.unit
    if unit.is_counted and assigned.quantity in DIMENSION_OF:
        unit = replace(unit, dimension=DIMENSION_OF[assigned.quantity])
    return replace(assigned, unit=unit, values=assigned.values * factor + (offset or 0.0))


def _said(by_name: Mapping[str, float], quantity: Quantity | None, axis: str) -> float | None:
    """Return what an entry says of a column, by its name with or without the axis."""
    name = _name_of(quantity)
    return by_name.get(f"{name}_{axis}", by_name.get(name))


def _as_recorded(column: Column, quantity: Quantity, axis: str, unit: Unit | None) -> Assigned:
    """A reference may be in any unit and need not have one: only its shape is used."""
    unit = unit or Unit(symbol="", dimension=Dimension.OTHER)
    values = column.values * unit.factor + unit.offset
    return Assigned(column=column, quantity=quantity, axis=axis, unit=unit, values=values)


def _unit_for(
    entry: RecordingEntry, column: Column, quantity: Quantity | None, axis: str
) -> Unit | None:
    name = _name_of(quantity)
    keys = (f"{name}_{axis}", name) if axis else (name,)
    for key in keys:
        if key in entry.units:
            return unit_of(entry.units[key])
    return column.heading.unit


def _name_of(quantity: Quantity | None) -> str:
    return "time" if quantity is None else quantity.name.lower()
