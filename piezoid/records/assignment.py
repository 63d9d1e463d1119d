"""Which column is which: from lab.toml where it says so, else from the headings; never a guess."""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import LabFileError
from piezoid.records.conversion import Assigned, converted
from piezoid.records.counters import unwrapped
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.meaning import Meaning, Role, meaning_of
from piezoid.records.recording import Quantity
from piezoid.records.refusal import places_of, refuse
from piezoid.records.table import Column, RawTable
from piezoid.records.units import Dimension, unit_of
from piezoid.statement import Statement, finding

_KEYS = {quantity.name.lower(): quantity for quantity in Quantity}
_PIEZO = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)


@dataclass(frozen=True, kw_only=True, eq=False)
class Assignment:
    """All columns that are read.

    time      None where the table has no time column
    channels  one per quantity and axis, in the order of the columns
    statements  units taken from the convention of lab.toml
    """

    time: Assigned | None
    channels: tuple[Assigned, ...]
    statements: tuple[Statement, ...]


def assign(table: RawTable, lab: Lab, entry: RecordingEntry) -> Assignment:
    """Decide what every column is, or refuse with what was seen and what to write.

    Raises ``UnitError`` for a column without unit or axis, or for two that claim the same part;
    ``LabFileError`` where lab.toml names a column that is not there.
    """
    _check_keys(lab, entry)
    if entry.columns:
        meanings = _declared(table, lab, entry)
    else:
        meanings = {c.number: (c, meaning_of(c.heading)) for c in table.columns if _has_values(c)}
        meanings = _with_lone_volts_settled(meanings)
    read = [(column, m) for column, m in meanings.values() if m.role is not Role.UNREAD]
    clocks = [(column, m) for column, m in read if m.role is Role.TIME]
    channels = _with_axes(table, entry, [(c, m) for c, m in read if m.role is Role.CHANNEL])
    if len(clocks) > 1:
        raise refuse(table, f"{places_of([c for c, _ in clocks])} are both a time")
    if not channels:
        raise refuse(table, "no column is a drive voltage or a displacement")
    time = [converted(table, lab, entry, column, None, "") for column, _ in clocks]
    given = [converted(table, lab, entry, c, quantity, axis) for c, quantity, axis in channels]
    assumed = [p for _, statements in (*time, *given) for p in statements]
    clock, wraps = _going_on(table, time[0][0]) if time else (None, ())
    return Assignment(
        time=clock,
        channels=tuple(assigned for assigned, _ in given),
        statements=(*assumed, *wraps),
    )


def _going_on(table: RawTable, time: Assigned) -> tuple[Assigned, tuple[Statement, ...]]:
    """Return a clock without the steps back of a counter that began anew."""
    values, rows, bits = unwrapped(time.values, time.unit.factor)
    if not len(rows):
        return time, ()
    first = table.place_of_row(int(rows[0]))
    text = (
        f"the clock is a counter of {bits} bits that begins anew {len(rows)} times, first at "
        f"{first}; the time goes on there"
    )
    return replace(time, values=values), (
        finding(quantity="wrapped_clock", place=first, text=text),
    )


def _has_values(column: Column) -> bool:
    return bool(np.isfinite(column.values).any())


def _declared(
    table: RawTable, lab: Lab, entry: RecordingEntry
) -> dict[int, tuple[Column, Meaning]]:
    """Return the columns lab.toml names, and the time column if the heading is plain."""
    found: dict[int, tuple[Column, Meaning]] = {}
    for key, wanted in entry.columns.items():
        column = table.find(wanted)
        if column is None or column.number in found:
            held = ", ".join(f"{c.number} {c.label!r}" for c in table.columns[:20])
            raise LabFileError(
                f"{lab.place}: {table.name} has no column {wanted!r} of its own for {key!r}, only "
                f"{held}",
                needed="one column of the file, by heading or by number from 1, for each name",
                remedy=f"Correct 'columns' of the entry for {table.name}.",
            )
        quantity, axis = _part(key)
        role = Role.TIME if quantity is None else Role.CHANNEL
        found[column.number] = (
            column,
            Meaning(role=role, quantity=quantity, axis=axis, by_name=True),
        )
    if "time" not in entry.columns and entry.sampling_rate_Hz is None:
        clocks = [c for c in table.columns if meaning_of(c.heading).role is Role.TIME]
        for column in clocks[:1]:
            found.setdefault(column.number, (column, Meaning(role=Role.TIME)))
    return found


def _part(key: str) -> tuple[Quantity | None, str | None]:
    name, _, axis = key.partition("_")
    return _KEYS.get(name), axis or None


def _check_keys(lab: Lab, entry: RecordingEntry) -> None:
    for key in (*entry.columns, *entry.units, *entry.scale, *entry.offset):
        name = key.partition("_")[0]
        if key != "time" and name not in _KEYS:
            raise LabFileError(
                f"{lab.place}: [[recording]] {entry.file!r} names {key!r}",
                needed=f"one of time, {', '.join(_KEYS)}, with an axis as in voltage_y",
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


def _with_lone_volts_settled(
    meanings: dict[int, tuple[Column, Meaning]],
) -> dict[int, tuple[Column, Meaning]]:
    """Drop what only a unit speaks for where a name speaks for another column.

    ``voltage [V], position [um], Monitor [V]``: the monitor is one more volt column, not a rival.
    """
    named = {(m.quantity, m.axis) for _, m in meanings.values() if m.by_name}
    named_quantities = {quantity for quantity, _ in named}
    settled = {}
    for number, (column, m) in meanings.items():
        is_lone = m.role is Role.CHANNEL and not m.by_name and m.quantity in named_quantities
        if is_lone and (m.axis is None or (m.quantity, m.axis) in named):
            reason = "another column is named for this quantity"
            settled[number] = (column, Meaning(role=Role.UNREAD, reason=reason))
        else:
            settled[number] = (column, m)
    return settled


def _with_axes(
    table: RawTable, entry: RecordingEntry, channels: list[tuple[Column, Meaning]]
) -> list[tuple[Column, Quantity, str]]:
    """Give every channel its axis and refuse two of one kind, or volts that may be anything."""
    parts = [(column, m.quantity, m.axis, m.by_name) for column, m in channels if m.quantity]
    lone = [c for c, quantity, _, named in parts if quantity is Quantity.VOLTAGE and not named]
    if lone and not any(quantity is Quantity.DISPLACEMENT for _, quantity, _, _ in parts):
        raise refuse(table, f"{places_of(lone)} in volts may be a drive or a sensor's output")
    default = _default_axis(table, entry, [(quantity, axis) for _, quantity, axis, _ in parts])
    found: dict[tuple[Quantity, str], Column] = {}
    for column, quantity, axis, _ in parts:
        key = (quantity, axis or default)
        if key in found:
            pair = places_of([found[key], column])
            raise refuse(table, f"{pair} both claim to be the {quantity.name.lower()} of {key[1]}")
        found[key] = column
    return [(column, quantity, axis) for (quantity, axis), column in found.items()]


def _default_axis(
    table: RawTable, entry: RecordingEntry, parts: list[tuple[Quantity, str | None]]
) -> str:
    """The axis of columns that name none: the entry's, else the file's only one, else x."""
    if entry.axis is not None:
        return entry.axis
    named = sorted({axis for quantity, axis in parts if axis is not None and quantity in _PIEZO})
    bare = [quantity for quantity, axis in parts if axis is None and quantity in _PIEZO]
    taken = {quantity for quantity, axis in parts if axis is not None}
    if len(named) == 1 and not taken & set(bare):
        return named[0]
    if len(named) > 1 and bare and "x" in named:
        kinds = ", ".join(quantity.name.lower() for quantity in bare)
        raise refuse(table, f"the file names the axes {', '.join(named)}, but not that of {kinds}")
    return "x"
