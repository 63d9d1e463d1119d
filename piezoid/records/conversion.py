"""One column in SI units: by the unit of its heading or of lab.toml; volts of a sensor by gain."""

from dataclasses import dataclass

from piezoid.errors import UnitError
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.meaning import DIMENSION_OF
from piezoid.records.recording import Problem, Quantity
from piezoid.records.refusal import refuse
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Dimension, Unit, unit_of


@dataclass(frozen=True, kw_only=True, eq=False)
class Assigned:
    """One column with its part in the recording.

    quantity  None for the time column
    axis      empty for the time column
    unit      it was converted from, of the heading or of lab.toml
    values    (rows,)  SI units, NaN kept
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
) -> tuple[Assigned, tuple[Problem, ...]]:
    """Convert a column to SI units, volts of a sensor by the sensor's gain.

    quantity, axis  None and empty for a time
    returned        the column, and what was taken to be so and is told

    Raises ``UnitError`` for a column without unit, in one of something else, or in volts of a
    sensor whose gain is not known.
    """
    unit = _unit_for(entry, column, quantity, axis)
    if quantity is Quantity.REFERENCE:
        return _as_recorded(column, quantity, axis, unit), ()
    wanted = Dimension.TIME if quantity is None else DIMENSION_OF[quantity]
    problems: tuple[Problem, ...] = ()
    if unit is None and quantity is Quantity.VOLTAGE and entry.columns:
        unit = Unit(symbol="V", dimension=Dimension.VOLTAGE)
        text = f"{column.place} has no unit; a voltage that lab.toml names is taken to be in volts"
        problems = (Problem(kind="unit_assumed", place=column.place, text=text),)
    if unit is None:
        raise refuse(table, f"{column.place} is a {_name_of(quantity)} without a unit")
    values = column.values * unit.factor + unit.offset
    if quantity is Quantity.DISPLACEMENT and unit.dimension is Dimension.VOLTAGE:
        gain_V_per_m = lab.sensor_of(axis).gain_V_per_m
        if gain_V_per_m is None:
            raise UnitError(
                f"{table.name}: {column.place} is a displacement of axis {axis} in volts",
                needed="the sensor's gain is needed to know it in metres",
                remedy="Write into lab.toml:\n\n[sensor]\ngain_V_per_m = ...\n",
            )
        values = values / gain_V_per_m
    elif unit.dimension is not wanted:
        raise refuse(
            table, f"{column.place} is a {_name_of(quantity)} by name but in {unit.symbol}"
        )
    assigned = Assigned(column=column, quantity=quantity, axis=axis, unit=unit, values=values)
    return assigned, problems


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
