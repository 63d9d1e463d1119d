"""Which column is what of a frequency response: from lab.toml, else from headings; never a guess.

A file is one where a column is a frequency, swept, and no column is a time, or lab.toml says so.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from piezoid.errors import LabFileError, RecordingError, UnitError
from piezoid.records.column_roles import Role, meaning_of
from piezoid.records.columns import first_values, missing_column
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.recording import Quantity
from piezoid.records.response_units import Kind, bare, unit_in_heading
from piezoid.records.table import Column, RawTable

PARTS = ("frequency", "magnitude", "phase", "real", "imaginary", "coherence", "excitation")
COMPLEX = "response"  # one name of lab.toml for both columns a complex array is read as
_WORDS = {
    "frequency": {"frequency", "freq", "f", "frequenz", "omega"},
    "phase": {"phase", "phi", "theta", "arg", "angle"},
    "magnitude": {"magnitude", "mag", "gain", "amplitude", "amp", "abs", "modulus", "betrag"},
    "real": {"real", "re"},
    "imaginary": {"imaginary", "imag", "im"},
    "coherence": {"coherence", "coh", "msc", "koh", "kohärenz"},
}
# A frequency that is measured, not swept; a property of a fit; a spread.
_FOREIGN = {"shift", "std", "stddev", "error", "fit", "model", "residual", "set", "setpoint"}
_TOKENS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-zäöü]+|\d+")
_LETTERS = "xyz"
_AXIS_PAIR = re.compile(r"(?<![a-zA-Z])[HGhg]?_?([xyz])_?([xyz])(?![a-zA-Z])")
_AXIS = re.compile(r"(?<![a-zA-Z])[HGhg]?_?([xyz])(?![a-zA-Z])")
_AXIS_NUMBERS = re.compile(r"\((\d),(\d)\)|(?<![a-zA-Z])[HGhg]_?([1-3])([1-3])(?!\d)")

Pair = tuple[str, str]


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseColumns:
    """The columns of one response.

    frequency  what the others are a function of
    paths      by output and drive, the columns by their part
    by_number  whether axes were numbered, and 1, 2, 3 are read as x, y, z
    is_named   whether the file or lab.toml names an axis
    """

    frequency: Column
    paths: Mapping[Pair, Mapping[str, Column]]
    by_number: bool = False
    is_named: bool = True


@dataclass(kw_only=True, eq=False)
class _Parts:
    """Columns by their part in the response; the pair is None where no axis is named."""

    frequency: list[Column] = field(default_factory=list)
    paths: dict[Pair | None, dict[str, Column]] = field(default_factory=dict)
    by_number: bool = False


def is_response(table: RawTable, entry: RecordingEntry | None) -> bool:
    """Whether a table is a frequency response: by the names in lab.toml, else by its headings."""
    if entry is not None and entry.columns:
        return "frequency" in entry.columns
    swept = [c for c in table.columns if part_of(c) == "frequency"]
    if not swept:
        return False
    parts_of_file = _by_heading(table)
    is_complete = any(_is_complete(parts) for parts in parts_of_file.paths.values())
    if any(meaning_of(c.heading).role is Role.TIME for c in table.columns):
        # Beside a clock a frequency is swept where it goes one way only.
        return is_complete and any(_is_swept(column) for column in swept)
    quantities = {
        m.quantity for c in table.columns if (m := meaning_of(c.heading)).by_name and m.quantity
    }
    return is_complete or not {Quantity.VOLTAGE, Quantity.DISPLACEMENT} <= quantities


def response_columns(table: RawTable, lab: Lab, entry: RecordingEntry) -> ResponseColumns:
    """Decide what every column is, or refuse with what was seen and what to write."""
    check_names(lab, entry)
    if not entry.columns:
        _refuse_both(table)
    parts_of_file = _declared(table, lab, entry) if entry.columns else _by_heading(table)
    if len(parts_of_file.frequency) != 1:
        places = " and ".join(c.place for c in parts_of_file.frequency) or "no column"
        raise refuse_response(table, f"{places} is the frequency")
    paths, is_named = _with_axes(table, entry, parts_of_file)
    for pair, parts in paths.items():
        if not _is_complete(parts):
            names = ", ".join(parts) or "nothing"
            of = f" of {pair[0]} to a drive of {pair[1]}" if len(paths) > 1 else ""
            raise refuse_response(table, f"{names} alone is no response{of}")
    if not paths:
        raise refuse_response(table, "no column is a magnitude, a phase or a part of a response")
    return ResponseColumns(
        frequency=parts_of_file.frequency[0],
        paths=paths,
        by_number=parts_of_file.by_number,
        is_named=is_named,
    )


def _is_complete(parts: Mapping[str, Column]) -> bool:
    return {"magnitude", "phase"} <= set(parts) or {"real", "imaginary"} <= set(parts)


def _is_swept(column: Column) -> bool:
    steps = np.diff(column.values[np.isfinite(column.values)])
    return len(steps) > 0 and bool((steps > 0).all() or (steps < 0).all())


def _refuse_both(table: RawTable) -> None:
    clocks = [c for c in table.columns if meaning_of(c.heading).role is Role.TIME]
    if clocks:
        raise RecordingError(
            f"{table.name}: {clocks[0].place} is a time, and beside it there is a frequency with "
            "a response: a recording over time and a frequency response in one file",
            needed="one of the two",
            remedy="Say which by naming its columns in lab.toml; for the response:\n\n"
            f"{response_block(table)}\n",
        )


def part_of(column: Column) -> str | None:
    """Return which part of a response a heading names, None where it names none."""
    words = {token.lower() for token in _TOKENS.findall(column.label)}
    if words & _FOREIGN:
        return None
    if column.label.startswith(("real(", "imag(")):
        return "real" if column.label.startswith("real(") else "imaginary"
    unit = unit_in_heading(column)
    if unit is None and column.heading.unit is not None:
        return None  # of forces, times and currents
    kind = None if unit is None else unit.kind
    for part, names in _WORDS.items():
        if words & names and (kind is None or kind in _KINDS[part]):
            return part
    return None


_GAINS = {Kind.GAIN, Kind.VOLTAGE_GAIN, Kind.LENGTH, Kind.VOLTAGE, Kind.DECIBEL}
_KINDS = {
    "frequency": {Kind.FREQUENCY},
    "phase": {Kind.ANGLE},
    "magnitude": _GAINS,
    "real": _GAINS,
    "imaginary": _GAINS,
    "coherence": {Kind.SHARE},
}


def _by_heading(table: RawTable) -> _Parts:
    parts_of_file = _Parts()
    for column in table.columns:
        part = part_of(column)
        if part == "frequency":
            parts_of_file.frequency.append(column)
        elif part is not None:
            pair, by_number = _pair_in(column.label)
            parts_of_file.by_number |= by_number
            parts = parts_of_file.paths.setdefault(pair, {})
            if part in parts:
                pairs = f"{parts[part].place} and {column.place}"
                raise refuse_response(table, f"{pairs} both claim to be the {part}")
            parts[part] = column
    return parts_of_file


def _pair_in(label: str) -> tuple[Pair | None, bool]:
    """Return output and drive that a heading names, and whether by number."""
    if match := _AXIS_NUMBERS.search(label):
        i, j = (int(number) - 1 for number in match.groups() if number is not None)
        return ((_LETTERS[i], _LETTERS[j]) if max(i, j) < len(_LETTERS) else None), True
    stem = re.sub(r"\[.*?\]|\(.*?\)", " ", bare(label))
    if match := _AXIS_PAIR.search(stem):
        return (match.group(1), match.group(2)), False
    if match := _AXIS.search(stem):
        return (match.group(1), match.group(1)), False
    return None, False


def _declared(table: RawTable, lab: Lab, entry: RecordingEntry) -> _Parts:
    """Return the columns that lab.toml names."""
    parts_of_file = _Parts()
    for key, wanted in entry.columns.items():
        name, pair = named_part(key)
        if name == "frequency":
            parts_of_file.frequency.append(_column(table, lab, key, wanted))
        elif name == COMPLEX:
            pieces = (("real", f"real({wanted})"), ("imaginary", f"imag({wanted})"))
            for part, label in pieces:
                parts_of_file.paths.setdefault(pair, {})[part] = _column(table, lab, key, label)
        else:
            parts_of_file.paths.setdefault(pair, {})[name] = _column(table, lab, key, wanted)
    return parts_of_file


def named_part(key: str) -> tuple[str, Pair | None]:
    """Take a name of lab.toml apart: ``phase_xy`` is the phase of x to a drive of y."""
    name, _, axis = key.partition("_")
    if not axis:
        return name, None
    if len(axis) == 2 and set(axis) <= set(_LETTERS):
        return name, (axis[0], axis[1])
    return name, (axis, axis)


def check_names(lab: Lab, entry: RecordingEntry) -> None:
    """Refuse names of an entry that are no part of a response, and what it cannot have."""
    known = (*PARTS, COMPLEX)
    for key in (*entry.columns, *entry.units, *entry.scale):
        if named_part(key)[0] not in known:
            raise LabFileError(
                f"{lab.place}: [[recording]] {entry.file!r}, a frequency response, names {key!r}",
                needed=f"one of {', '.join(known)}, with axes as in phase_x or phase_xy (x moves, "
                "y is driven)",
                remedy="Correct the name, or leave the frequency out for a recording over time.",
            )
    unusable = {
        "offset": entry.offset,
        "sampling_rate_Hz": entry.sampling_rate_Hz,
        "start_s": entry.start_s,
        "stop_s": entry.stop_s,
        "reverse": entry.reverse,
    }
    names = [name for name, value in unusable.items() if value]
    if names:
        raise LabFileError(
            f"{lab.place}: [[recording]] {entry.file!r} has {', '.join(names)}",
            needed="columns of a frequency response, which has no time and no offset",
            remedy="Leave it out.",
        )


def _column(table: RawTable, lab: Lab, key: str, name_or_number: str | int) -> Column:
    column = table.find(name_or_number)
    if column is None:
        raise missing_column(table, lab, key, name_or_number)
    return column


def _with_axes(
    table: RawTable, entry: RecordingEntry, parts_of_file: _Parts
) -> tuple[dict[Pair, dict[str, Column]], bool]:
    """Give what names no axis that of the entry, or of the only response; else x."""
    by_pair = {pair: parts for pair, parts in parts_of_file.paths.items() if pair is not None}
    unnamed = parts_of_file.paths.get(None, {})
    if not unnamed:
        return by_pair, True
    if len(by_pair) == 1 and entry.axis is None and not _is_complete(unnamed):
        pair = next(iter(by_pair))
        if not set(unnamed) & set(by_pair[pair]):
            return {pair: {**by_pair[pair], **unnamed}}, True
    if by_pair and entry.axis is None:
        places = " and ".join(column.place for column in unnamed.values())
        raise refuse_response(table, f"{places} names no axis, beside others that do")
    axis = entry.axis or "x"
    return {(axis, axis): unnamed, **by_pair}, entry.axis is not None


def refuse_response(table: RawTable, found: str) -> UnitError:
    """Refuse, showing the columns and the lines of lab.toml that would decide."""
    return UnitError(
        f"{table.name}: a frequency response, of which {found} (seen: {first_values(table)})",
        needed="a frequency in Hz, kHz or rad/s; magnitude in m/V, um/V, nm/V, V/V or decibels of "
        "one of these, with phase in deg or rad; or real and imaginary part",
        remedy="Write into lab.toml, with the headings or numbers (from 1) and units of your "
        f"columns:\n\n{response_block(table)}\n",
        columns=tuple(column.label for column in table.columns),
    )


def response_block(table: RawTable) -> str:
    """Return the ``[[recording]]`` entry to complete for a frequency response, as TOML."""
    from json import dumps

    held = {part: column for column in table.columns if (part := part_of(column)) is not None}
    names = {part: column.label for part, column in held.items()}
    parts = ["real", "imaginary"] if "real" in held else ["magnitude", "phase"]
    if names.get("real", "").startswith("real("):  # of a complex array
        parts, names[COMPLEX] = [COMPLEX], names["real"][len("real(") : -1]
    parts = ["frequency", *parts, *(["coherence"] if "coherence" in held else [])]
    columns = ", ".join(f"{part} = {dumps(names.get(part, '...'))}" for part in parts)
    units = ", ".join(
        f"{part} = {dumps(_unit_said(held.get(part)))}" for part in parts if part != "coherence"
    )
    return "\n".join(
        (
            "[[recording]]",
            f"file = {dumps(table.name)}",
            'axis = "x"',
            f"columns = {{ {columns} }}",
            f"units = {{ {units} }}",
        )
    )


def _unit_said(column: Column | None) -> str:
    unit = None if column is None else unit_in_heading(column)
    return "..." if unit is None or unit.kind is Kind.DECIBEL else unit.symbol
