"""Columns of a frequency response: their parts, axes and units, from lab.toml or from headings.

A file is a frequency response if a column is a swept frequency and no column is a time, or if
lab.toml declares one. Units are as instruments write them: m/V, dB re 1 um/V, deg, rad/s.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from json import dumps

import numpy as np

from piezoid.errors import LabFileError, RecordingError, UnitError
from piezoid.records.column_refusals import ambiguous_columns, clocks_of, missing_column
from piezoid.records.column_roles import meaning_of
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.lab_tables import entry_text
from piezoid.records.recording import Quantity
from piezoid.records.table import Column, RawTable
from piezoid.records.units import BRACKETS, Dimension, Unit, unit_of

AMPLITUDES = frozenset(
    {Dimension.GAIN, Dimension.VOLTAGE_GAIN, Dimension.LENGTH, Dimension.VOLTAGE}
)
# Units that recordings over time do not have, in lower case.
_UNITS = {
    **dict.fromkeys(("deg", "degree", "degrees", "°", "grad °"), (Dimension.ANGLE, np.pi / 180.0)),
    **dict.fromkeys(("rad", "radian", "radians"), (Dimension.ANGLE, 1.0)),
    "mrad": (Dimension.ANGLE, 1e-3),
    **dict.fromkeys(
        ("rad/s", "rad/sec", "rad s^-1", "rad_s", "rad_per_s"),
        (Dimension.FREQUENCY, 1.0 / (2.0 * np.pi)),
    ),
    "krad/s": (Dimension.FREQUENCY, 1e3 / (2.0 * np.pi)),
}
_PER_VOLT = {Dimension.LENGTH: Dimension.GAIN, Dimension.VOLTAGE: Dimension.VOLTAGE_GAIN}
_WITHOUT_VOLT = {Dimension.FREQUENCY, Dimension.LENGTH, Dimension.VOLTAGE, Dimension.RATIO}
_RATIO = re.compile(r"([A-Za-zµμÅ]+)\s?(?:/|_per_| per )\s?([A-Za-zµμ]+)")
_DECIBEL = re.compile(r"dB\s*(?:re\.?|of|rel\.?)?\s*[(\[]?\s*1?\s*(.*?)\s*[)\]]?", re.IGNORECASE)
_PART = re.compile(r"^(?:real|imag)\((.*)\)$")
_INDEX = re.compile(r"\(\d,\d\)$")
# A unit at the end of a name: ``phase_deg``, ``gain, um/V``, ``mag um_per_V``, ``freq/Hz``.
_UNITS_AT_END = (
    re.compile(r".*[\s,;_](rad_s|rad_per_s|[A-Za-zµμ]+_per_[A-Za-z]+)$"),
    re.compile(r".*[\s,;]([A-Za-zµμ°]+/[A-Za-zµμ]+)$"),
    re.compile(r".*[\s,;_/]([A-Za-zµμ°%]+)$"),
)


def response_unit(text: str) -> Unit | None:
    """Return the unit that a text names; None if it is not a unit of a frequency response."""
    symbol = " ".join(text.split())
    if symbol.lower() in _UNITS:
        dimension, factor = _UNITS[symbol.lower()]
        return Unit(symbol=symbol, dimension=dimension, factor=factor)
    if symbol.lower().startswith("db") and (match := _DECIBEL.fullmatch(symbol)):
        if not match[1]:
            return Unit(symbol=symbol, dimension=Dimension.DECIBEL, is_decibel=True)
        reference = response_unit(match[1])
        if reference is None or reference.is_decibel or reference.dimension not in AMPLITUDES:
            return None
        return replace(reference, symbol=symbol, is_decibel=True)
    if match := _RATIO.fullmatch(symbol):
        numerator, denominator = map(unit_of, match.groups())
        if numerator is None or denominator is None or numerator.dimension not in _PER_VOLT:
            return None
        if denominator.dimension is not Dimension.VOLTAGE:
            return None
        factor = numerator.factor / denominator.factor
        return Unit(symbol=symbol, dimension=_PER_VOLT[numerator.dimension], factor=factor)
    unit = unit_of(symbol)
    return unit if unit is not None and unit.dimension in _WITHOUT_VOLT else None


def _base_name(label: str) -> str:
    """Return a name without the additions of readers: ``real(H(1,2))`` is ``H``."""
    return _INDEX.sub("", _PART.sub(r"\1", label))


def unit_in_heading(column: Column) -> Unit | None:
    """Return the unit of a column that the format or its heading states, else None."""
    stated = [column.declared_unit] if column.declared_unit.strip() else []
    label = _base_name(" ".join(column.label.split()))
    # Units from a row of units lack the outer brackets: ``(dB (um/V))`` becomes ``dB (um/V``.
    stated += [text + ")" for text in stated if text.count("(") > text.count(")")]
    stated += [a or b for a, b in reversed(BRACKETS.findall(label))]
    stated += [match.group(1) for end in _UNITS_AT_END if (match := end.match(label))]
    return next((unit for text in stated if (unit := response_unit(text)) is not None), None)


_GAINS = AMPLITUDES | {Dimension.DECIBEL}
# Words that name a part of a response, and the units it may have.
_PARTS: dict[str, tuple[set[str], frozenset[Dimension]]] = {
    "frequency": (
        {"frequency", "freq", "f", "frequenz", "omega"},
        frozenset({Dimension.FREQUENCY}),
    ),
    "phase": ({"phase", "phi", "theta", "arg", "angle"}, frozenset({Dimension.ANGLE})),
    "magnitude": (
        {"magnitude", "mag", "gain", "amplitude", "amp", "abs", "modulus", "betrag"},
        _GAINS,
    ),
    "real": ({"real", "re"}, _GAINS),
    "imaginary": ({"imaginary", "imag", "im"}, _GAINS),
    "coherence": ({"coherence", "coh", "msc", "koh", "kohärenz"}, frozenset({Dimension.RATIO})),
}
COMPLEX = "response"  # name in lab.toml of a complex array, which is read as two columns
_NAMES = (*_PARTS, "excitation", COMPLEX)
# Words of columns that are no part of a response: a measured frequency, a fit, a spread.
_OTHER_WORDS = {"shift", "std", "stddev", "error", "fit", "model", "residual", "set", "setpoint"}
_TOKENS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-zäöü]+|\d+")
_LETTERS = "xyz"
_AXIS_PAIR = re.compile(r"(?<![a-zA-Z])[HGhg]?_?([xyz])_?([xyz])(?![a-zA-Z])")
_AXIS = re.compile(r"(?<![a-zA-Z])[HGhg]?_?([xyz])(?![a-zA-Z])")
_AXIS_NUMBERS = re.compile(r"\((\d),(\d)\)|(?<![a-zA-Z])[HGhg]_?([1-3])([1-3])(?!\d)")

Pair = tuple[str, str]  # axis that moves, axis that is driven
Part = tuple[str, Pair | None, Column]  # name, axes or None without any, column


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseColumns:
    """The columns of one response.

    frequency  the swept column
    paths      columns by their part, by output and drive
    by_number  whether the axes are numbered; 1, 2, 3 are read as x, y, z
    is_named   whether the file or lab.toml names an axis
    """

    frequency: Column
    paths: Mapping[Pair, Mapping[str, Column]]
    by_number: bool = False
    is_named: bool = True


def is_response(table: RawTable, entry: RecordingEntry) -> bool:
    """Return whether a table is a frequency response, by the entry or else by its headings."""
    if entry.columns:
        return "frequency" in entry.columns
    parts = _parts_by_heading(table)
    swept = [column for part, _, column in parts if part == "frequency"]
    names_of_pair: dict[Pair | None, set[str]] = {}
    for part, pair, _ in parts:
        names_of_pair.setdefault(pair, set()).add(part)
    is_complete = any(map(_is_complete, names_of_pair.values()))
    if swept and clocks_of(table):
        # In a table with a clock a swept frequency rises or falls throughout.
        steps = [np.diff(c.values[np.isfinite(c.values)]) for c in swept]
        return is_complete and any(len(s) and ((s > 0).all() or (s < 0).all()) for s in steps)
    quantities = {
        m.quantity for c in table.columns if (m := meaning_of(c.heading)).by_name and m.quantity
    }
    is_recording = {Quantity.VOLTAGE, Quantity.DISPLACEMENT} <= quantities
    return bool(swept) and (is_complete or not is_recording)


def response_columns(table: RawTable, lab: Lab, entry: RecordingEntry) -> ResponseColumns:
    """Assign a role to each column; errors contain the lines to write into lab.toml."""
    parts = _parts_by_entry(table, lab, entry)
    clocks = clocks_of(table)
    if clocks and not entry.columns:
        raise RecordingError(
            f"{table.name}: {clocks[0].place} is a time, and there is also a frequency with a "
            "response: a recording over time and a frequency response in one file",
            needed="one of the two",
            remedy="Name the columns of one of them in lab.toml; for the response:\n\n"
            f"{response_block(table)}\n",
        )
    parts = parts or _parts_by_heading(table)
    frequencies = [column for part, _, column in parts if part == "frequency"]
    paths: dict[Pair | None, dict[str, Column]] = {}
    for part, pair, column in parts:
        if part != "frequency":
            first = paths.setdefault(pair, {}).setdefault(part, column)
            if first is not column:
                locations = f"{first.place} and {column.place}"
                raise ambiguous_response(table, f"{locations} both claim to be the {part}")
    if len(frequencies) != 1:
        locations = " and ".join(c.place for c in frequencies) or "no column"
        raise ambiguous_response(table, f"{locations} is the frequency")
    by_pair, is_named = _assign_axes(table, entry, paths)
    for pair, columns in by_pair.items():
        if not _is_complete(columns):
            of = f" of {pair[0]} to a drive of {pair[1]}" if len(by_pair) > 1 else ""
            raise ambiguous_response(table, f"{', '.join(columns)} alone is no response{of}")
    if not by_pair:
        raise ambiguous_response(
            table, "no column is a magnitude, a phase or a part of a response"
        )
    return ResponseColumns(
        frequency=frequencies[0],
        paths=by_pair,
        by_number=not entry.columns and any(_AXIS_NUMBERS.search(c.label) for _, _, c in parts),
        is_named=is_named,
    )


def _is_complete(parts: Iterable[str]) -> bool:
    return {"magnitude", "phase"} <= set(parts) or {"real", "imaginary"} <= set(parts)


def part_of(column: Column) -> str | None:
    """Return the part of a response that a heading names, or None."""
    words = {token.lower() for token in _TOKENS.findall(column.label)}
    if words & _OTHER_WORDS:
        return None
    if column.label.startswith(("real(", "imag(")):
        return "real" if column.label.startswith("real(") else "imaginary"
    unit = unit_in_heading(column)
    if unit is None and column.heading.unit is not None:
        return None  # a force, a time or a current
    for part, (names, dimensions) in _PARTS.items():
        if words & names and (unit is None or unit.dimension in dimensions):
            return part
    return None


def _parts_by_heading(table: RawTable) -> list[Part]:
    """Return the columns whose headings name a part, with the output and the drive if named."""
    parts: list[Part] = []
    for column in table.columns:
        part, pair = part_of(column), None
        stem = re.sub(r"\[.*?\]|\(.*?\)", " ", _base_name(column.label))
        if part is None:
            continue
        if part == "frequency":
            pass
        elif match := _AXIS_NUMBERS.search(column.label):
            i, j = (int(number) - 1 for number in match.groups() if number is not None)
            pair = (_LETTERS[i], _LETTERS[j]) if max(i, j) < len(_LETTERS) else None
        elif match := _AXIS_PAIR.search(stem) or _AXIS.search(stem):
            pair = match[1], match[match.lastindex or 1]
        parts.append((part, pair, column))
    return parts


def _parts_by_entry(table: RawTable, lab: Lab, entry: RecordingEntry) -> list[Part]:
    """Return the columns that lab.toml names; refuse names and keys that responses do not have."""
    for key in (*entry.columns, *entry.units, *entry.scale):
        if _parse_name(key)[0] not in _NAMES:
            raise LabFileError(
                f"{lab.place}: [[recording]] {entry.file!r}, a frequency response, names {key!r}",
                needed=f"one of {', '.join(_NAMES)}, with axes as in phase_x or phase_xy (x "
                "moves, y is driven)",
                remedy="Correct the name, or leave the frequency out for a recording over time.",
            )
    keys = ("offset", "sampling_rate_Hz", "start_s", "stop_s", "reverse")
    unusable = [key for key in keys if getattr(entry, key)]
    if unusable:
        raise LabFileError(
            f"{lab.place}: [[recording]] {entry.file!r} has {', '.join(unusable)}",
            needed="columns of a frequency response, which has no time and no offset",
            remedy="Leave it out.",
        )
    parts: list[Part] = []
    for key, name_or_number in entry.columns.items():
        name, pair = _parse_name(key)
        labels: dict[str, str | int] = {name: name_or_number}
        if name == COMPLEX:
            labels = {"real": f"real({name_or_number})", "imaginary": f"imag({name_or_number})"}
        for part, label in labels.items():
            column = table.find(label)
            if column is None:
                raise missing_column(table, lab, key, label)
            parts.append((part, pair, column))
    return parts


def _parse_name(key: str) -> tuple[str, Pair | None]:
    """Parse a name of lab.toml: ``phase_xy`` is the phase of x to a drive of y."""
    name, _, axis = key.partition("_")
    if not axis:
        return name, None
    if len(axis) == 2 and set(axis) <= set(_LETTERS):
        return name, (axis[0], axis[1])
    return name, (axis, axis)


def _assign_axes(
    table: RawTable, entry: RecordingEntry, paths: Mapping[Pair | None, dict[str, Column]]
) -> tuple[dict[Pair, dict[str, Column]], bool]:
    """Return the columns by path, and whether an axis is named.

    Columns without an axis belong to the axis of the entry, to the only response, or else to x.
    """
    by_pair = {pair: columns for pair, columns in paths.items() if pair is not None}
    unnamed = paths.get(None, {})
    if not unnamed:
        return by_pair, True
    if len(by_pair) == 1 and entry.axis is None and not _is_complete(unnamed):
        ((pair, columns),) = by_pair.items()
        if not set(unnamed) & set(columns):
            return {pair: {**columns, **unnamed}}, True
    if by_pair and entry.axis is None:
        locations = " and ".join(column.place for column in unnamed.values())
        raise ambiguous_response(table, f"{locations} names no axis, unlike other columns")
    axis = entry.axis or "x"
    return {(axis, axis): unnamed, **by_pair}, entry.axis is not None


def ambiguous_response(table: RawTable, reason: str) -> UnitError:
    """Return an error with the columns and the lines of lab.toml that resolve the ambiguity."""
    return ambiguous_columns(
        table,
        f"a frequency response: {reason}",
        needed="a frequency in Hz, kHz or rad/s; magnitude in m/V, um/V, nm/V, V/V or decibels of "
        "one of these, with phase in deg or rad; or real and imaginary part",
        template=response_block(table),
    )


def response_block(table: RawTable) -> str:
    """Return the ``[[recording]]`` entry to complete for a frequency response, as TOML."""
    column_of = {part: column for column in table.columns if (part := part_of(column))}
    labels = {part: column.label for part, column in column_of.items()}
    parts = ["real", "imaginary"] if "real" in column_of else ["magnitude", "phase"]
    if labels.get("real", "").startswith("real("):  # a complex array
        parts, labels[COMPLEX] = [COMPLEX], labels["real"][len("real(") : -1]
    symbols = {}
    for part in ("frequency", *parts):
        unit = unit_in_heading(column_of[part]) if part in column_of else None
        is_known = unit is not None and unit.dimension is not Dimension.DECIBEL
        symbols[part] = unit.symbol if unit is not None and is_known else "..."
    coherence = ["coherence"] if "coherence" in column_of else []
    columns = [f"{p} = {dumps(labels.get(p, '...'))}" for p in (*symbols, *coherence)]
    units = [f"{part} = {dumps(symbol)}" for part, symbol in symbols.items()]
    return entry_text(
        table.name,
        'axis = "x"',
        f"columns = {{ {', '.join(columns)} }}",
        f"units = {{ {', '.join(units)} }}",
    )
