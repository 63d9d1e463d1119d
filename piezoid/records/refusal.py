"""The refusal of an ambiguous file: what was seen in it, and the lines of lab.toml that decide."""

import json

from piezoid.errors import UnitError
from piezoid.records.meaning import Role, meaning_of
from piezoid.records.table import Column, RawTable

_SHOWN_COLUMNS = 8
_SHOWN_VALUES = 3


def places_of(columns: list[Column]) -> str:
    """Name several columns."""
    return " and ".join(column.place for column in columns)


def refuse(table: RawTable, found: str) -> UnitError:
    """Refuse, showing the columns and the lines of lab.toml that would decide."""
    seen = [
        f"{c.place}: {', '.join(f'{value:.6g}' for value in c.values[:_SHOWN_VALUES])}, ..."
        for c in table.columns[:_SHOWN_COLUMNS]
    ]
    more = len(table.columns) - _SHOWN_COLUMNS
    seen += [f"and {more} more columns"] if more > 0 else []
    return UnitError(
        f"{table.name}: {found} (seen: {'; '.join(seen)})",
        needed="one meaning, one axis and one unit for every column that is read",
        remedy="Write into lab.toml, with the headings or numbers (from 1) and units of your "
        f"columns:\n\n{lab_block(table)}\n",
        columns=tuple(column.label for column in table.columns),
    )


def lab_block(table: RawTable) -> str:
    """Return the ``[[recording]]`` entry to complete for this file, as TOML."""
    clock = [c for c in table.columns if meaning_of(c.heading).role is Role.TIME]
    columns = [f"time = {_toml(clock[0].label)}"] if clock else []
    columns += ['voltage = "..."', 'displacement = "..."']
    lines = [
        "[[recording]]",
        f"file = {_toml(table.name)}",
        'axis = "x"',
        f"columns = {{ {', '.join(columns)} }}",
        'units = { voltage = "...", displacement = "..." }',
    ]
    units = [column.heading.unit for column in table.columns]
    if any(unit is not None and unit.is_counted for unit in units):
        lines[-1] = 'units = { voltage = "counts", displacement = "counts" }'
        lines.append("scale = { voltage = ..., displacement = ... }  # V and m of one count")
    if not clock and table.sampling_rate_Hz is None:
        lines.append("sampling_rate_Hz = ...")
    return "\n".join(lines)


def _toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=True)
