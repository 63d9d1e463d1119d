"""Ingest: from a table and the declarations of lab.toml to a FrequencyResponseRecord."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import RecordingError, UnitError
from piezoid.numerics.arrays import Array
from piezoid.records.columns import sensor_gain_V_per_m
from piezoid.records.frequency_response import (
    CHAIN,
    MIN_LINES,
    FrequencyResponseRecord,
    ResponsePath,
)
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.lab_tables import entry_text
from piezoid.records.response_columns import (
    AMPLITUDES,
    COMPLEX,
    Pair,
    ResponseColumns,
    ambiguous_response,
    response_columns,
    response_unit,
    unit_in_heading,
)
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension, Unit
from piezoid.statement import Statement, finding

# Range of the phase about its regression line. A mode turns the phase by half a turn, a delay
# along a straight line: the phase of ten modes deviates by less. Degrees read as radians deviate
# by 180 for each mode.
MAX_STRAY_rad = 10.0 * np.pi
# With such a change of the gain the phase changes by tens of degrees (Bode); radians read as
# degrees stay within 6.3.
MIN_GAIN_CHANGE_dB = 6.0
MAX_RADIANS_deg = 2.0 * np.pi
REMOVE_ROWS = "Remove these rows from the file; gaps between frequencies are allowed."


def ingest_response(table: RawTable, lab: Lab, entry: RecordingEntry) -> FrequencyResponseRecord:
    """Make a frequency response of a table that ``is_response`` recognises.

    Raises ``UnitError`` for a column without unit or meaning, ``RecordingError`` for invalid
    numbers, ``LabFileError`` if lab.toml names a column that the file does not have.
    """
    columns = response_columns(table, lab, entry)
    for column in (columns.frequency, *(c for p in columns.paths.values() for c in p.values())):
        missing = np.flatnonzero(~np.isfinite(column.values))
        if len(missing):
            raise RecordingError(
                f"{table.name}: {len(missing)} of {table.rows} rows of {column.place} hold no "
                f"number, the first is {table.row_name(int(missing[0]))}",
                needed="a number in every row of a frequency response",
                remedy=REMOVE_ROWS,
            )
    # A complex array is valid input here.
    statements = [s for s in table.statements if s.quantity != "complex"]
    frequency_Hz, rows = _frequency_Hz(table, entry, columns, statements)
    paths = [
        _PathReader(table, lab, entry, columns, pair, rows).read(frequency_Hz, statements)
        for pair in columns.paths
    ]
    if columns.by_number:
        text = "axes are numbered: 1, 2, 3 are read as x, y, z, the one that moves first"
        statements.append(finding("numbered_axes", text, place="its headings"))
    return FrequencyResponseRecord(
        name=table.name,
        digest=table.digest,
        frequency_Hz=frequency_Hz,
        paths=tuple(paths),
        axis_is_named=columns.is_named,
        includes=CHAIN if entry.includes is None else tuple(entry.includes),
        statements=tuple(statements),
    )


def _frequency_Hz(
    table: RawTable, entry: RecordingEntry, columns: ResponseColumns, statements: list[Statement]
) -> tuple[Array, NDArray[np.intp]]:
    """Return the frequencies above zero in rising order, and their rows of the table."""
    column, symbol = columns.frequency, entry.units.get("frequency")
    unit = unit_in_heading(column) if symbol is None else response_unit(symbol)
    if unit is None or unit.dimension is not Dimension.FREQUENCY:
        state = "has no unit" if unit is None else f"is in {unit.symbol}"
        raise ambiguous_response(table, f"{column.place} {state}")
    f = column.values * unit.factor
    if (f < 0).any():
        row = int(np.argmax(f < 0))
        raise RecordingError(
            f"{table.name}: {int((f < 0).sum())} frequencies are negative, the first is "
            f"{f[row]:.6g} Hz at {table.row_name(row)}",
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
            f"{table.name}: {f[rows[row]]:.6g} Hz at {table.row_name(int(rows[row]))} {order} "
            f"{f[rows[row - 1]]:.6g} Hz; {int((steps <= 0).sum())} frequencies do not rise",
            needed="each frequency once, in order",
            remedy="Sort the rows; of several sweeps keep one, average them, or write each into a "
            "file of its own.",
        )
    if not f[rows[0]] > 0:
        rows = rows[1:]
        text = "the line at 0 Hz is left out: it holds the offset, not a response"
        statements.append(finding("zero_frequency", text, place=column.place))
    if len(rows) < MIN_LINES:
        raise RecordingError(
            f"{table.name}: {len(rows)} frequencies",
            needed=f"at least {MIN_LINES}",
            remedy="Save the whole sweep.",
        )
    return f[rows], rows


@dataclass(frozen=True, eq=False)
class _PathReader:
    """Reader of the columns of one path: the response of an output to a drive.

    rows  (lines,)  of the table
    """

    table: RawTable
    lab: Lab
    entry: RecordingEntry
    columns: ResponseColumns
    pair: Pair
    rows: NDArray[np.intp]

    def read(self, frequency_Hz: Array, statements: list[Statement]) -> ResponsePath:
        """Convert the columns to a response in m/V."""
        parts = self.columns.paths[self.pair]
        if {"real", "imaginary"} <= set(parts):
            location = parts["real"].place
            response = self._amplitude("real") + 1j * self._amplitude("imaginary")
            if "magnitude" in parts:
                text = "real and imaginary part are read; magnitude and phase are redundant"
                statements.append(finding("said_twice", text, place=location))
        else:
            location, size = parts["magnitude"].place, self._amplitude("magnitude")
            self._refuse_rows(
                size < 0,
                "magnitude",
                needed="a magnitude above zero",
                remedy="If it is in decibels, write units = { magnitude = "
                '"dB re 1 um/V" }, or the actual reference of 0 dB, into lab.toml.',
            )
            response = size * np.exp(1j * self._angle_rad(size, frequency_Hz))
        zero = np.flatnonzero(response == 0)
        if len(zero):
            raise RecordingError(
                f"{self.table.name}: the response in {location} is zero in {len(zero)} rows, the "
                f"first is {self.table.row_name(int(self.rows[zero[0]]))}",
                needed="a response that is not zero: nothing was measured there",
                remedy=REMOVE_ROWS,
            )
        if "excitation" in parts:
            values, unit = self._values("excitation")
            if unit is None or unit.dimension is not Dimension.VOLTAGE:
                raise self._ambiguous("excitation", "is an excitation that is not in volts")
            self._refuse_rows(
                ~(values > 0),
                "excitation",
                needed="an amplitude above zero: the response is divided by it",
                remedy="Remove these rows from the file, or name another column.",
            )
            response = response / (values * unit.factor)
        coherence = None
        if "coherence" in parts:
            values, unit = self._values("coherence")
            coherence = values * (1.0 if unit is None else unit.factor)
            self._refuse_rows(
                (coherence < 0.0) | (coherence > 1.0),
                "coherence",
                needed="a coherence (magnitude squared) from 0 to 1",
                remedy='If it is in percent, write units = { coherence = "%" } into lab.toml.',
            )
        return ResponsePath(
            output=self.pair[0],
            drive=self.pair[1],
            response_m_per_V=response,
            coherence=coherence,
        )

    def _values(self, part: str) -> tuple[Array, Unit | None]:
        """Return the values of a column, and its unit from lab.toml or its heading."""
        column = self.columns.paths[self.pair][part]
        symbol = self._declaration(self.entry.units, part)
        unit = unit_in_heading(column) if symbol is None else response_unit(symbol)
        if symbol is not None and unit is None:
            raise ambiguous_response(self.table, f"the unit of {part} is {symbol!r}")
        return column.values[self.rows], unit

    def _declaration(self, by_name: Mapping[str, Any], part: str) -> Any:
        """Return the declaration of an entry for a column: by path, part or response."""
        names = [part, COMPLEX] if part in ("magnitude", "real", "imaginary") else [part]
        output, drive = self.pair
        endings = [f"_{output}{drive}", *([f"_{output}"] if output == drive else []), ""]
        keys = [f"{name}{ending}" for name in names for ending in endings]
        return next((by_name[key] for key in keys if key in by_name), None)

    def _ambiguous(self, part: str, state: str) -> UnitError:
        location = self.columns.paths[self.pair][part].place
        return ambiguous_response(self.table, f"{location} {state}")

    def _refuse_rows(
        self, is_refused: NDArray[np.bool_], part: str, *, needed: str, remedy: str
    ) -> None:
        """Refuse a column with an impossible value; the error names the first one."""
        if is_refused.any():
            column, row = self.columns.paths[self.pair][part], int(self.rows[is_refused.argmax()])
            raise RecordingError(
                f"{self.table.name}: {column.place} is {column.values[row]:.6g} at "
                f"{self.table.row_name(row)}",
                needed=needed,
                remedy=remedy,
            )

    def _amplitude(self, part: str) -> Array:
        """Return magnitude, real or imaginary part in m/V, or in m if there is an excitation."""
        values, unit = self._values(part)
        if unit is None:
            raise self._ambiguous(part, "has no unit")
        if unit.dimension is Dimension.DECIBEL:
            raise self._ambiguous(
                part,
                "is in dB without a reference: write 'dB re 1 um/V', or the actual reference of "
                "0 dB",
            )
        if unit.dimension not in AMPLITUDES:
            raise self._ambiguous(part, f"is in {unit.symbol}")
        scale = self._declaration(self.entry.scale, part)
        has_excitation = any(key.startswith("excitation") for key in self.entry.columns)
        is_amplitude = unit.dimension in (Dimension.LENGTH, Dimension.VOLTAGE)
        if is_amplitude and not has_excitation and scale is None:
            raise self._ambiguous(
                part,
                f"is in {unit.symbol}, an amplitude and not a response: the amplitude of the "
                "drive is needed, as a column 'excitation' or as scale = { response = 1 / volts }",
            )
        values = 10.0 ** (values / 20.0) if unit.is_decibel else values
        if unit.dimension in (Dimension.VOLTAGE, Dimension.VOLTAGE_GAIN):
            output, location = self.pair[0], self.columns.paths[self.pair][part].place
            volts = (
                f"{self.table.name}: {location} is a response of axis {output} in {unit.symbol}"
            )
            gain_V_per_m = sensor_gain_V_per_m(self.lab, output, volts, needed="metres per volt")
            values = values / gain_V_per_m
        return np.asarray(values * unit.factor * (1.0 if scale is None else scale))

    def _angle_rad(self, size: Array, frequency_Hz: Array) -> Array:
        """Return the phase; refuse one that is obviously in the other unit."""
        values, unit = self._values("phase")
        if unit is None or unit.dimension is not Dimension.ANGLE:
            state = "has no unit" if unit is None else f"is in {unit.symbol}"
            raise self._ambiguous("phase", f"{state}, and not in deg or rad")
        angle_rad, largest = values * unit.factor, float(np.abs(values).max())
        changed_dB = 20.0 * float(np.log10(size.max() / size.min())) if size.min() > 0 else 0.0
        if "deg" in unit.symbol.lower() or "°" in unit.symbol:
            likely = "rad"
            is_wrong = largest <= MAX_RADIANS_deg and changed_dB > MIN_GAIN_CHANGE_dB
        else:
            likely = "deg"
            line = np.polynomial.Polynomial.fit(frequency_Hz, angle_rad, 1)
            is_wrong = float(np.ptp(angle_rad - line(frequency_Hz))) > MAX_STRAY_rad
        if is_wrong:
            location = self.columns.paths[self.pair]["phase"].place
            raise UnitError(
                f"{self.table.name}: {location} is declared in {unit.symbol} and reaches "
                f"{largest:.4g} while the gain changes by {changed_dB:.3g} dB: the unit is wrong",
                needed=f"the true unit of the phase; {likely} is plausible",
                remedy="If that is the unit, write into lab.toml:\n\n"
                + entry_text(self.table.name, f'units = {{ phase = "{likely}" }}\n'),
            )
        return np.asarray(angle_rad)
