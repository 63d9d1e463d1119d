"""From a table and what lab.toml says about it to a FrequencyResponseRecord, or a refusal."""

from collections.abc import Mapping
from dataclasses import dataclass
from json import dumps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import RecordingError, UnitError
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.records.columns import sensor_gain_V_per_m
from piezoid.records.frequency_response import (
    CHAIN,
    FEWEST_LINES,
    FrequencyResponseRecord,
    ResponsePath,
)
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.response_columns import COMPLEX, Pair, ambiguous_response, response_columns
from piezoid.records.response_units import AMPLITUDES, Kind, response_unit, unit_in_heading
from piezoid.records.response_units import ResponseUnit as Unit
from piezoid.records.table import Column, RawTable
from piezoid.statement import Statement, finding

# A mode turns the phase by half a turn, a delay along a straight line: the phase of ten modes
# strays from its own line by less. Degrees taken for radians stray by 180 for each mode.
MAX_STRAY_rad = 10.0 * np.pi
# A gain that changes so much turns the phase by tens of degrees (Bode); radians taken for degrees
# stay within one turn's 6.3.
MIN_GAIN_CHANGE_dB = 6.0
MAX_RADIANS_deg = 2.0 * np.pi


def ingest_response(
    table: RawTable, lab: Lab, entry: RecordingEntry | None
) -> FrequencyResponseRecord:
    """Make a frequency response of a table that ``is_response`` recognises.

    Raises ``UnitError`` for what has no unit or meaning, ``RecordingError`` for numbers that are
    no response, ``LabFileError`` where lab.toml names what is not there.
    """
    entry = RecordingEntry(file=table.name) if entry is None else entry
    columns = response_columns(table, lab, entry)
    for column in (columns.frequency, *(c for p in columns.paths.values() for c in p.values())):
        missing = np.flatnonzero(~np.isfinite(column.values))
        if len(missing):
            raise RecordingError(
                f"{table.name}: {len(missing)} of {table.rows} rows of {column.place} hold no "
                f"number, the first is {table.place_of_row(int(missing[0]))}",
                needed="a number in every row of a frequency response",
                remedy="Take these rows out of the file; gaps between frequencies are allowed.",
            )
    # A complex array is read in two parts, which is no finding here.
    statements = [s for s in table.statements if s.quantity != "complex"]
    frequency_Hz, rows = _frequency_Hz(table, entry, columns.frequency, statements)
    paths = tuple(
        _Path(
            table=table,
            lab=lab,
            entry=entry,
            pair=pair,
            parts=parts,
            frequency_Hz=frequency_Hz,
            rows=rows,
        ).read(statements)
        for pair, parts in columns.paths.items()
    )
    if columns.by_number:
        text = "axes are numbered: 1, 2, 3 are read as x, y, z, the one that moves first"
        statements.append(finding("numbered_axes", text, place="its headings"))
    return FrequencyResponseRecord(
        name=table.name,
        digest=table.digest,
        frequency_Hz=frequency_Hz,
        paths=paths,
        axis_is_named=columns.is_named,
        includes=CHAIN if entry.includes is None else tuple(entry.includes),
        statements=tuple(statements),
    )


def _frequency_Hz(
    table: RawTable, entry: RecordingEntry, column: Column, statements: list[Statement]
) -> tuple[Array, NDArray[np.intp]]:
    """Return the frequencies above zero, rising, and their rows of the table."""
    unit = _unit_of(table, entry, "frequency", None, column)
    if unit is None or unit.kind is not Kind.FREQUENCY:
        state = "has no unit" if unit is None else f"is in {unit.symbol}"
        raise ambiguous_response(table, f"{column.place} {state}")
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
        statements.append(finding("downward", text, place=column.place))
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
        statements.append(finding("zero_frequency", text, place=column.place))
    if len(rows) < FEWEST_LINES:
        raise RecordingError(
            f"{table.name}: {len(rows)} frequencies",
            needed=f"at least {FEWEST_LINES}",
            remedy="Save the whole sweep.",
        )
    return f[rows], rows


@dataclass(frozen=True, kw_only=True, eq=False)
class _Path:
    """The columns of one path: how an output responds to a drive.

    parts         by ``magnitude``, ``phase`` and so on
    frequency_Hz  (lines,)
    rows          (lines,)  of the table
    """

    table: RawTable
    lab: Lab
    entry: RecordingEntry
    pair: Pair
    parts: Mapping[str, Column]
    frequency_Hz: Array
    rows: NDArray[np.intp]

    def read(self, statements: list[Statement]) -> ResponsePath:
        """Convert the columns to a response in m/V."""
        column = self.parts.get("real") or self.parts["magnitude"]
        if {"real", "imaginary"} <= set(self.parts):
            response = self._amplitude("real") + 1j * self._amplitude("imaginary")
            if "magnitude" in self.parts:
                text = "real and imaginary part are read; magnitude and phase say the same again"
                statements.append(finding("said_twice", text, place=column.place))
        else:
            column = self.parts["magnitude"]
            size = self._amplitude("magnitude")
            if (size < 0).any():
                row = int(self.rows[np.argmax(size < 0)])
                raise RecordingError(
                    f"{self.table.name}: {column.place} is {column.values[row]:.6g} at "
                    f"{self.table.place_of_row(row)}",
                    needed="a magnitude above zero",
                    remedy="If it is in decibels, say so in lab.toml: units = { magnitude = "
                    '"dB re 1 um/V" }, or of whatever its 0 dB is.',
                )
            response = size * np.exp(1j * self._angle_rad(size))
        zero = np.flatnonzero(response == 0)
        if len(zero):
            raise RecordingError(
                f"{self.table.name}: the response in {column.place} is zero in {len(zero)} rows, "
                f"the first is {self.table.place_of_row(int(self.rows[zero[0]]))}",
                needed="a response that is not zero: nothing was measured there",
                remedy="Take these rows out of the file; gaps between frequencies are allowed.",
            )
        return ResponsePath(
            output=self.pair[0],
            drive=self.pair[1],
            response_m_per_V=self._per_excitation(response),
            coherence=self._coherence(),
        )

    def _amplitude(self, part: str) -> Array:
        """Return magnitude, real or imaginary part in m/V, or in m beside an excitation."""
        column, unit = self.parts[part], self._unit_of(part)
        if unit is None:
            raise ambiguous_response(self.table, f"{column.place} has no unit")
        if unit.kind is Kind.DECIBEL:
            reason = "is in dB, and nothing says of what: write 'dB re 1 um/V', or of whatever"
            raise ambiguous_response(self.table, f"{column.place} {reason} its 0 dB is")
        if unit.kind not in AMPLITUDES:
            raise ambiguous_response(self.table, f"{column.place} is in {unit.symbol}")
        scale = _declared(self.entry.scale, part, self.pair)
        has_excitation = any(key.startswith("excitation") for key in self.entry.columns)
        if unit.kind in (Kind.LENGTH, Kind.VOLTAGE) and not has_excitation and scale is None:
            raise ambiguous_response(
                self.table,
                f"{column.place} is in {unit.symbol}, an amplitude and not yet a response: the "
                "drive's is needed, as a column 'excitation' or as scale = { response = 1 / volts "
                "}",
            )
        values = 10.0 ** (column.values / 20.0) if unit.is_decibel else column.values
        if unit.kind in (Kind.VOLTAGE, Kind.VOLTAGE_GAIN):
            values = values / sensor_gain_V_per_m(
                self.lab,
                self.pair[0],
                f"{self.table.name}: {column.place} is a response of axis {self.pair[0]} in "
                f"{unit.symbol}",
                needed="metres per volt",
            )
        return np.asarray(values * unit.factor * (1.0 if scale is None else scale))[self.rows]

    def _angle_rad(self, size: Array) -> Array:
        """Return the phase, or refuse one that is plainly in the other unit."""
        column, unit = self.parts["phase"], self._unit_of("phase")
        if unit is None or unit.kind is not Kind.ANGLE:
            state = "has no unit" if unit is None else f"is in {unit.symbol}"
            raise ambiguous_response(self.table, f"{column.place} {state}, and not in deg or rad")
        values = column.values[self.rows]
        angle_rad, largest = np.asarray(values * unit.factor), float(np.abs(values).max())
        changed_dB = 20.0 * float(np.log10(size.max() / size.min())) if size.min() > 0 else 0.0
        if "deg" in unit.symbol.lower() or "°" in unit.symbol:
            likely = "rad"
            is_wrong = largest <= MAX_RADIANS_deg and changed_dB > MIN_GAIN_CHANGE_dB
        else:
            likely = "deg"
            line = np.polynomial.Polynomial.fit(self.frequency_Hz, angle_rad, 1)
            is_wrong = float(np.ptp(angle_rad - line(self.frequency_Hz))) > MAX_STRAY_rad
        if is_wrong:
            raise UnitError(
                f"{self.table.name}: {column.place} is said to be in {unit.symbol} and reaches "
                f"{largest:.4g} while the gain changes by {changed_dB:.3g} dB: obviously other "
                "units",
                needed=f"the phase in the unit it is written in; {likely} would fit",
                remedy="If it is, write into lab.toml:\n\n[[recording]]\n"
                f'file = {dumps(self.table.name)}\nunits = {{ phase = "{likely}" }}\n',
            )
        return angle_rad

    def _per_excitation(self, response: ComplexArray) -> ComplexArray:
        """Return the response; of a displacement's amplitude, over that of the drive."""
        column = self.parts.get("excitation")
        if column is None:
            return response
        unit = self._unit_of("excitation")
        if unit is None or unit.kind is not Kind.VOLTAGE:
            raise ambiguous_response(
                self.table, f"{column.place} is an excitation that is not in volts"
            )
        drive_V = column.values[self.rows] * unit.factor
        if not (drive_V > 0).all():
            row = int(self.rows[np.argmin(drive_V)])
            raise RecordingError(
                f"{self.table.name}: {column.place} is {drive_V.min():.6g} V at "
                f"{self.table.place_of_row(row)}",
                needed="an amplitude above zero: the response is divided by it",
                remedy="Take these rows out of the file, or name another column.",
            )
        return np.asarray(response / drive_V)

    def _coherence(self) -> Array | None:
        column = self.parts.get("coherence")
        if column is None:
            return None
        unit = self._unit_of("coherence")
        values = np.asarray(column.values[self.rows] * (1.0 if unit is None else unit.factor))
        if values.min() < 0.0 or values.max() > 1.0:
            raise RecordingError(
                f"{self.table.name}: {column.place} goes from {values.min():.4g} to "
                f"{values.max():.4g}",
                needed="a coherence (magnitude squared) from 0 to 1",
                remedy='If it is in percent, write units = { coherence = "%" } into lab.toml.',
            )
        return values

    def _unit_of(self, part: str) -> Unit | None:
        return _unit_of(self.table, self.entry, part, self.pair, self.parts[part])


def _unit_of(
    table: RawTable, entry: RecordingEntry, part: str, pair: Pair | None, column: Column
) -> Unit | None:
    symbol = _declared(entry.units, part, pair)
    if symbol is None:
        return unit_in_heading(column)
    unit = response_unit(symbol)
    if unit is None:
        raise ambiguous_response(table, f"the unit of {part} is {symbol!r}")
    return unit


def _declared(by_name: Mapping[str, Any], part: str, pair: Pair | None) -> Any:
    """Return what an entry says of a column: of its path, of the part, of the whole response."""
    names = [part, COMPLEX] if part in ("magnitude", "real", "imaginary") else [part]
    endings = [""]
    if pair is not None:
        endings = [f"_{pair[0]}{pair[1]}", *([f"_{pair[0]}"] if pair[0] == pair[1] else []), ""]
    keys = [f"{name}{ending}" for name in names for ending in endings]
    return next((by_name[key] for key in keys if key in by_name), None)
