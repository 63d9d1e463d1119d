"""From a table and what lab.toml says about it to a FrequencyResponseRecord, or a refusal."""

from collections.abc import Mapping
from dataclasses import dataclass
from json import dumps
from typing import TypeVar

import numpy as np

from piezoid.errors import PiezoidError, RecordingError, UnitError
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.records.frequency_response import (
    CHAIN,
    FEWEST_LINES,
    FrequencyResponseRecord,
    ResponsePath,
)
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.response_columns import (
    COMPLEX,
    Pair,
    ResponseColumns,
    refuse_response,
    response_columns,
)
from piezoid.records.response_units import Kind, ResponseUnit, response_unit, unit_in_heading
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

_T = TypeVar("_T")
# A mode turns the phase by half a turn, a delay along a straight line: the phase of ten modes
# strays from its own line by less. Degrees taken for radians stray by 180 for each mode.
MAX_STRAY_rad = 10.0 * np.pi
# A gain that changes so much turns the phase by tens of degrees (Bode); radians taken for degrees
# stay within one turn's 6.3.
MIN_GAIN_CHANGE_dB = 6.0
MAX_RADIANS_deg = 2.0 * np.pi


@dataclass(frozen=True, kw_only=True, eq=False)
class _Context:
    """The file being read, and the statements about it so far."""

    table: RawTable
    lab: Lab
    entry: RecordingEntry
    statements: list[Statement]


def ingest_response(
    table: RawTable, lab: Lab, entry: RecordingEntry | None
) -> FrequencyResponseRecord:
    """Make a frequency response of a table that ``is_response`` recognises.

    Raises ``UnitError`` for what has no unit or meaning, ``RecordingError`` for numbers that are
    no response, ``LabFileError`` where lab.toml names what is not there.
    """
    entry = RecordingEntry(file=table.name) if entry is None else entry
    columns = response_columns(table, lab, entry)
    # A complex array is read in two parts, which is no finding here.
    context = _Context(
        table=table,
        lab=lab,
        entry=entry,
        statements=[p for p in table.statements if p.quantity != "complex"],
    )
    _refuse_missing(table, columns)
    frequency_Hz, rows = _frequency(context, columns.frequency)
    paths = tuple(
        _path(context, pair, parts, frequency_Hz, rows) for pair, parts in columns.paths.items()
    )
    if columns.by_number:
        text = "axes are numbered: 1, 2, 3 are read as x, y, z, the one that moves first"
        context.statements.append(
            finding(quantity="numbered_axes", place="its headings", text=text)
        )
    return FrequencyResponseRecord(
        name=table.name,
        digest=table.digest,
        frequency_Hz=frequency_Hz[rows],
        paths=paths,
        axis_is_named=columns.is_named,
        includes=CHAIN if entry.includes is None else tuple(entry.includes),
        statements=tuple(context.statements),
    )


def _refuse_missing(table: RawTable, columns: ResponseColumns) -> None:
    for column in (columns.frequency, *(c for p in columns.paths.values() for c in p.values())):
        missing = np.flatnonzero(~np.isfinite(column.values))
        if len(missing):
            raise RecordingError(
                f"{table.name}: {len(missing)} of {table.rows} rows of {column.place} hold no "
                f"number, the first is {table.place_of_row(int(missing[0]))}",
                needed="a number in every row of a frequency response",
                remedy="Take these rows out of the file; gaps between frequencies are allowed.",
            )


def _frequency(context: _Context, column: Column) -> tuple[Array, np.ndarray]:
    """Return all frequencies, Hz, and the rows to use in increasing order."""
    table = context.table
    unit = _unit_for(context, "frequency", None, column)
    if unit is None or unit.kind is not Kind.FREQUENCY:
        state = "has no unit" if unit is None else f"is in {unit.symbol}"
        raise refuse_response(table, f"{column.place} {state}")
    f = np.asarray(column.values * unit.factor)
    if (f < 0).any():
        row = int(np.argmax(f < 0))
        raise RecordingError(
            f"{table.name}: {int((f < 0).sum())} frequencies are negative, the first is "
            f"{f[row]:.6g} Hz at {table.place_of_row(row)}",
            needed="frequencies above zero",
            remedy="Save the one-sided response; of a shift from a centre, add the centre.",
        )
    rows = np.arange(len(f))
    if (np.diff(f) < 0).all() and len(f) > 1:
        rows = rows[::-1]
        text = "frequencies fall from row to row; they are read from the last row on"
        context.statements.append(finding(quantity="downward", place=column.place, text=text))
    steps = np.diff(f[rows])
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        order = "repeats" if steps[row - 1] == 0 else "follows"
        raise RecordingError(
            f"{table.name}: {f[rows[row]]:.6g} Hz at {table.place_of_row(int(rows[row]))} {order} "
            f"{f[rows[row - 1]]:.6g} Hz; {int((steps <= 0).sum())} frequencies do not rise",
            needed="each frequency once, in order",
            remedy="Sort the rows; of several sweeps keep one, average them, or write each into a "
            "file of its own.",
        )
    if not f[rows[0]] > 0:
        rows = rows[1:]
        text = "the line at 0 Hz is left out: it holds the offset, not a response"
        context.statements.append(
            finding(quantity="zero_frequency", place=column.place, text=text)
        )
    if len(rows) < FEWEST_LINES:
        raise RecordingError(
            f"{table.name}: {len(rows)} frequencies",
            needed=f"at least {FEWEST_LINES}",
            remedy="Save the whole sweep.",
        )
    return f, rows


def _path(
    context: _Context,
    pair: Pair,
    parts: Mapping[str, Column],
    frequency_Hz: Array,
    rows: np.ndarray,
) -> ResponsePath:
    column = parts.get("real") or parts["magnitude"]
    if {"real", "imaginary"} <= set(parts):
        response = (
            _gain(context, pair, "real", parts["real"])[rows]
            + 1j * _gain(context, pair, "imaginary", parts["imaginary"])[rows]
        )
        if "magnitude" in parts:
            text = "real and imaginary part are read; magnitude and phase say the same again"
            context.statements.append(
                finding(quantity="said_twice", place=column.place, text=text)
            )
    else:
        column = parts["magnitude"]
        size = _gain(context, pair, "magnitude", column)[rows]
        _refuse_below_zero(context.table, column, size, rows)
        angle = _angle(context, pair, parts["phase"], size, frequency_Hz[rows], rows)
        response = size * np.exp(1j * angle)
    _refuse_zero(context.table, column, response, rows)
    return ResponsePath(
        output=pair[0],
        drive=pair[1],
        response_m_per_V=_per_excitation(context, pair, parts, response, rows),
        coherence=_coherence(context, pair, parts.get("coherence"), rows),
    )


def _gain(context: _Context, pair: Pair, part: str, column: Column) -> Array:
    """Return magnitude, real or imaginary part in m/V, or in m beside an excitation."""
    unit = _unit_for(context, part, pair, column)
    if unit is None:
        raise refuse_response(context.table, f"{column.place} has no unit")
    if unit.kind is Kind.DECIBEL:
        raise refuse_response(
            context.table,
            f"{column.place} is in dB, and nothing says of what: write 'dB re 1 um/V', or of "
            "whatever its 0 dB is",
        )
    scale = _declared(context.entry.scale, part, pair)
    if unit.kind in (Kind.LENGTH, Kind.VOLTAGE):
        if "excitation" not in {key.partition("_")[0] for key in context.entry.columns} and (
            scale is None
        ):
            raise refuse_response(
                context.table,
                f"{column.place} is in {unit.symbol}, an amplitude and not yet a response: the "
                "drive's is needed, as a column 'excitation' or as scale = { response = 1 / volts "
                "}",
            )
    elif unit.kind not in (Kind.GAIN, Kind.VOLTAGE_GAIN):
        raise refuse_response(context.table, f"{column.place} is in {unit.symbol}")
    values = 10.0 ** (column.values / 20.0) if unit.is_decibel else column.values
    if unit.kind in (Kind.VOLTAGE, Kind.VOLTAGE_GAIN):
        values = values / _sensor_gain(context, pair[0], column, unit)
    return np.asarray(values * unit.factor * (1.0 if scale is None else scale))


def _sensor_gain(context: _Context, axis: str, column: Column, unit: ResponseUnit) -> float:
    gain_V_per_m = context.lab.sensor_of(axis).gain_V_per_m
    if gain_V_per_m is None:
        raise UnitError(
            f"{context.table.name}: {column.place} is a response of axis {axis} in {unit.symbol}",
            needed="the sensor's gain, to know it in metres per volt",
            remedy="Write into lab.toml:\n\n[sensor]\ngain_V_per_m = ...\n",
        )
    return gain_V_per_m


def _angle(
    context: _Context,
    pair: Pair,
    column: Column,
    size: Array,
    frequency_Hz: Array,
    rows: np.ndarray,
) -> Array:
    unit = _unit_for(context, "phase", pair, column)
    if unit is None or unit.kind is not Kind.ANGLE:
        state = "has no unit" if unit is None else f"is in {unit.symbol}"
        raise refuse_response(context.table, f"{column.place} {state}, and not in deg or rad")
    angle = np.asarray(column.values[rows] * unit.factor)
    changed_dB = 20.0 * float(np.log10(size.max() / size.min())) if size.min() > 0 else 0.0
    if "deg" in unit.symbol.lower() or "°" in unit.symbol:
        largest = float(np.abs(column.values[rows]).max())
        if largest <= MAX_RADIANS_deg and changed_dB > MIN_GAIN_CHANGE_dB:
            raise _wrong_angle(context, column, unit, largest, "rad", changed_dB)
        return angle
    line = np.polynomial.Polynomial.fit(frequency_Hz, angle, 1)
    stray_rad = float(np.ptp(angle - line(frequency_Hz)))
    if stray_rad > MAX_STRAY_rad:
        largest = float(np.abs(column.values[rows]).max())
        raise _wrong_angle(context, column, unit, largest, "deg", changed_dB)
    return angle


def _wrong_angle(
    context: _Context,
    column: Column,
    unit: ResponseUnit,
    largest: float,
    likely: str,
    changed_dB: float,
) -> UnitError:
    return UnitError(
        f"{context.table.name}: {column.place} is said to be in {unit.symbol} and reaches "
        f"{largest:.4g} while the gain changes by {changed_dB:.3g} dB: obviously other units",
        needed=f"the phase in the unit it is written in; {likely} would fit",
        remedy=f"If it is, write into lab.toml:\n\n[[recording]]\n"
        f'file = {dumps(context.table.name)}\nunits = {{ phase = "{likely}" }}\n',
    )


def _per_excitation(
    context: _Context,
    pair: Pair,
    parts: Mapping[str, Column],
    response: ComplexArray,
    rows: np.ndarray,
) -> ComplexArray:
    """Return the response; of a displacement's amplitude, over that of the drive."""
    column = parts.get("excitation")
    if column is None:
        return response
    unit = _unit_for(context, "excitation", pair, column)
    if unit is None or unit.kind is not Kind.VOLTAGE:
        raise refuse_response(
            context.table, f"{column.place} is an excitation that is not in volts"
        )
    drive_V = column.values[rows] * unit.factor
    if not (drive_V > 0).all():
        row = int(rows[np.argmin(drive_V)])
        raise RecordingError(
            f"{context.table.name}: {column.place} is {drive_V.min():.6g} V at "
            f"{context.table.place_of_row(row)}",
            needed="an amplitude above zero: the response is divided by it",
            remedy="Take these rows out of the file, or name another column.",
        )
    return np.asarray(response / drive_V)


def _refuse_below_zero(table: RawTable, column: Column, size: Array, rows: np.ndarray) -> None:
    if (size < 0).any():
        row = int(rows[np.argmax(size < 0)])
        raise RecordingError(
            f"{table.name}: {column.place} is {column.values[row]:.6g} at "
            f"{table.place_of_row(row)}",
            needed="a magnitude above zero",
            remedy="If it is in decibels, say so in lab.toml: units = { magnitude = "
            '"dB re 1 um/V" }, or of whatever its 0 dB is.',
        )


def _refuse_zero(
    table: RawTable, column: Column, response: ComplexArray, rows: np.ndarray
) -> None:
    zero = np.flatnonzero(response == 0)
    if len(zero):
        raise RecordingError(
            f"{table.name}: the response in {column.place} is zero in {len(zero)} rows, the first "
            f"is {table.place_of_row(int(rows[zero[0]]))}",
            needed="a response that is not zero: nothing was measured there",
            remedy="Take these rows out of the file; gaps between frequencies are allowed.",
        )


def _coherence(
    context: _Context, pair: Pair, column: Column | None, rows: np.ndarray
) -> Array | None:
    if column is None:
        return None
    unit = _unit_for(context, "coherence", pair, column)
    values = np.asarray(column.values[rows] * (1.0 if unit is None else unit.factor))
    if values.min() < 0.0 or values.max() > 1.0:
        raise RecordingError(
            f"{context.table.name}: {column.place} goes from {values.min():.4g} to "
            f"{values.max():.4g}",
            needed="a coherence (magnitude squared) from 0 to 1",
            remedy='If it is in percent, write units = { coherence = "%" } into lab.toml.',
        )
    return values


def _declared(by_name: Mapping[str, _T], part: str, pair: Pair | None) -> _T | None:
    """Return what an entry says of a column: of its path, of the part, of the whole response."""
    is_gain = part in ("magnitude", "real", "imaginary")
    keys = []
    for name in (part, *([COMPLEX] if is_gain else [])):
        if pair is not None:
            keys.append(f"{name}_{pair[0]}{pair[1]}")
            keys += [f"{name}_{pair[0]}"] if pair[0] == pair[1] else []
        keys.append(name)
    return next((by_name[key] for key in keys if key in by_name), None)


def _unit_for(
    context: _Context, part: str, pair: Pair | None, column: Column
) -> ResponseUnit | None:
    symbol = _declared(context.entry.units, part, pair)
    if symbol is None:
        return unit_in_heading(column)
    unit = response_unit(symbol)
    if unit is None:
        raise refuse_response(context.table, f"the unit of {part} is {symbol!r}")
    return unit


def not_a_recording_error(table: RawTable) -> PiezoidError:
    """Return the refusal of a frequency response where a recording over time is asked for."""
    return RecordingError(
        f"{table.name}: a frequency response, not a recording over time",
        needed="a recording over time here",
        remedy="Give it to piezoid fit beside a slow sweep of the same axis.",
    )
