"""Refusals of files with ambiguous columns, with the lines of lab.toml that resolve them."""

import re
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

from piezoid.errors import LabFileError, UnitError
from piezoid.records.column_roles import meaning_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.lab_tables import entry_text
from piezoid.records.recording import Quantity
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Unit, unit_of
from piezoid.toml_files import toml_string

_MAX_COLUMNS, _MAX_VALUES = 8, 3  # in a message


def clocks_of(table: RawTable) -> list[Column]:
    """Return the columns whose headings name a time."""
    return [c for c in table.columns if meaning_of(c.heading).is_time]


def missing_column(table: RawTable, lab: Lab, key: str, name_or_number: str | int) -> LabFileError:
    """Return the error for a column that lab.toml names and the file does not have."""
    columns = ", ".join(f"{c.number} {c.label!r}" for c in table.columns[:20])
    remedy = f"Correct 'columns' of the entry for {table.name}."
    if isinstance(name_or_number, str) and name_or_number.isdigit():
        remedy = f"Write column numbers without quotes: {key} = {name_or_number}."
    return LabFileError(
        f"{lab.place}: {table.name} has no column {name_or_number!r} for {key!r}, only {columns}",
        needed="one column of the file, by heading or by number from 1, for each name",
        remedy=remedy,
    )


def name_of(quantity: Quantity | None) -> str:
    """Return the name of a quantity in lab.toml; None is the time."""
    return "time" if quantity is None else quantity.name.lower()


def stated_unit(
    entry: RecordingEntry, column: Column, quantity: Quantity | None, axis: str
) -> Unit | None:
    """Return the unit that lab.toml or the heading states, or None."""
    name = name_of(quantity)
    # An entry declares a column by its name with or without the axis.
    symbol = entry.units.get(f"{name}_{axis}", entry.units.get(name))
    return column.heading.unit if symbol is None else unit_of(symbol)


def refuse_missing_units(
    table: RawTable,
    lab: Lab,
    entry: RecordingEntry,
    columns: Sequence[tuple[Column, Quantity | None, str]],
) -> None:
    """Refuse columns that need a unit and have none, all of them in one message.

    A reference needs none, and a voltage that lab.toml names is read as volts.
    """
    unitless = [
        (column, quantity, axis)
        for column, quantity, axis in columns
        if stated_unit(entry, column, quantity, axis) is None
        and quantity is not Quantity.REFERENCE
        and not (quantity is Quantity.VOLTAGE and entry.columns)
    ]
    if not unitless:
        return
    if entry.columns and entry in lab.recordings:
        keys = [
            key if (key := f"{name_of(quantity)}_{axis}") in entry.columns else name_of(quantity)
            for _, quantity, axis in unitless
        ]
        gaps = [f"{key} ({c.place})" for key, (c, _, _) in zip(keys, unitless, strict=True)]
        lines = ", ".join(f'{key} = "..."' for key in keys)
        raise UnitError(
            f"{lab.place}: the [[recording]] of {table.name} states no unit of "
            f"{' and '.join(gaps)}",
            needed="a unit, because the heading of the column has none",
            remedy=f"Add to units of that entry: {lines}",
            columns=tuple(column.label for column in table.columns),
        )
    first, *further = unitless
    problem = f"{first[0].place} is a {name_of(first[1])}"
    problem += "".join(
        f", {column.place} a {name_of(quantity)}" for column, quantity, _ in further
    )
    problem += ", each without a unit" if further else " without a unit"
    if not any(quantity is Quantity.VOLTAGE for _, quantity, _ in columns):
        problem += "; no column is a drive voltage by its heading"
    labels = {name_of(quantity): column for column, quantity, _ in columns}
    template = entry_template(table, labels)
    axes = [entry.axis for entry in lab.recordings if entry.axis is not None]
    raise ambiguous_columns(table, problem, template=with_axis(template, axes))


def ambiguous_columns(
    table: RawTable,
    problem: str,
    *,
    needed: str = "one meaning, one axis and one unit for every column that is read",
    template: str = "",
) -> UnitError:
    """Return an error with the columns and the lines of lab.toml that resolve the ambiguity.

    template  the ``[[recording]]`` entry to complete; default: that of a recording over time
    """
    columns = [
        f"{c.place}: {', '.join(f'{value:.6g}' for value in c.values[:_MAX_VALUES])}, ..."
        for c in table.columns[:_MAX_COLUMNS]
    ]
    remaining = len(table.columns) - _MAX_COLUMNS
    columns += [f"and {remaining} more columns"] if remaining > 0 else []
    return UnitError(
        f"{table.name}: {problem} (seen: {'; '.join(columns)})",
        needed=needed,
        remedy="Write into lab.toml, with the headings or numbers (from 1) and units of your "
        f"columns:\n\n{template or entry_template(table)}\n",
        columns=tuple(column.label for column in table.columns),
    )


def entry_template(table: RawTable, known: Mapping[str, Column] = MappingProxyType({})) -> str:
    """Return the ``[[recording]]`` entry to complete for this file, as TOML.

    known  columns whose headings name their quantity, by name; of these only units are missing
    """
    columns, units = [], []
    clocks = clocks_of(table)
    if clocks:
        columns.append(f"time = {toml_string(clocks[0].label)}")
        units += [] if clocks[0].heading.unit else ['time = "..."']
    is_counted = any(
        c.heading.unit is not None and c.heading.unit.is_counted for c in table.columns
    )
    unit = "counts" if is_counted else "..."
    for name in ("voltage", "displacement"):
        column = known.get(name)
        reference = '"..."'
        if column is not None:  # by its number if the heading is not unique
            is_unique = table.find(column.label) is column
            reference = toml_string(column.label) if is_unique else str(column.number)
        columns.append(f"{name} = {reference}")
        if column is None or column.heading.unit is None:
            units.append(f'{name} = "{unit}"')
    lines = [
        'axis = "x"',
        f"columns = {{ {', '.join(columns)} }}",
        f"units = {{ {', '.join(units)} }}",
    ]
    if is_counted:
        lines.append("scale = { voltage = ..., displacement = ... }  # V and m of one count")
    if not clocks and table.sampling_rate_Hz is None:
        lines.append('sampling_rate_Hz = ...  # unless time = "..." is among the columns')
    return entry_text(table.name, *lines)


def with_axis(text: str, axes: Collection[str]) -> str:
    """Return a message whose entries to complete propose the axis of the other recordings.

    axes  of the other recordings; unless they have the same, the axis stays x
    """
    if len(set(axes)) != 1:
        return text
    axis = f"axis = {toml_string(min(axes))}"
    return re.sub(
        r'^(# )?axis = "x"(?=\n(# )?columns)',
        lambda match: f"{match[1] or ''}{axis}",
        text,
        flags=re.MULTILINE,
    )
