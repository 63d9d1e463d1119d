"""RawTable: the columns of a file as a reader returns them, not interpreted."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.units import MAX_HEADING, Heading, heading_of, unit_of
from piezoid.statement import Statement

# Larger values mean "out of range": instruments write 9.9e37 (SCPI) or 1e308.
LARGEST = 9e36
_SHORTEST_s, _LONGEST_s = 1e-30, 1e30  # limits of a valid interval


def rate_of(interval_s: float | None) -> float | None:
    """Return the sampling rate of a stated interval; None if the interval is invalid."""
    if interval_s is None or not _SHORTEST_s <= interval_s <= _LONGEST_s:
        return None
    return 1 / interval_s


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """One column of a file.

    number         index in the file, from 1
    label          heading in the file, empty without one
    declared_unit  unit that the format states outside the heading, empty without one
    values         (rows,)  in the file's unit; NaN for missing numbers
    """

    number: int
    label: str
    declared_unit: str = ""
    values: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", self.label[:MAX_HEADING])
        values = np.array(self.values, dtype=np.float64, order="C", copy=True).reshape(-1)
        values[~(np.abs(values) < LARGEST)] = np.nan
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    @property
    def heading(self) -> Heading:
        """Name and unit; a unit stated by the format takes precedence over the heading."""
        heading = heading_of(self.label)
        declared = unit_of(self.declared_unit) if self.declared_unit.strip() else None
        return heading if declared is None else Heading(stem=heading.stem, unit=declared)

    @property
    def place(self) -> str:
        """Name of the column in messages."""
        return f"column {self.number} {self.label!r}" if self.label else f"column {self.number}"

    @property
    def si_values(self) -> Array:
        """The values in SI units; unconverted if the unit is unknown."""
        unit = self.heading.unit
        return self.values if unit is None else self.values * unit.factor + unit.offset


@dataclass(frozen=True, kw_only=True, eq=False)
class RawTable:
    """Table of one file; ``read_table`` adds name, digest and format to the result of a reader.

    columns           all of the same length
    name              the file's name without its folder
    digest            of the file's bytes
    format            name of the format in messages: ``Nanonis``, ``text table``, ...
    sampling_rate_Hz  if the format states a clock instead of a time column
    independent       label of the swept column in formats that sweep another quantity than time;
                      empty otherwise
    segment_starts    (count,)  first row of each segment after the first
    first_line        line of the first row in a text file, 0 if it is unknown
    first_row         number of rows of the file in front of the table, if it is a part of the file
    is_reversed       whether the order of the rows is opposite to that of the file
    metadata          entries of the file outside its table
    statements        problems that the reader found
    """

    columns: tuple[Column, ...]
    name: str = ""
    digest: str = ""
    format: str = ""
    sampling_rate_Hz: float | None = None
    independent: str = ""
    segment_starts: tuple[int, ...] = ()
    first_line: int = 0
    first_row: int = 0
    is_reversed: bool = False
    metadata: Mapping[str, str] = field(default_factory=dict)
    statements: tuple[Statement, ...] = ()

    def __post_init__(self) -> None:
        lengths = {len(column.values) for column in self.columns}
        if len(lengths) != 1:
            raise ValueError(f"{self.name}: columns of lengths {sorted(lengths)}")
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.columns[0].values)

    def find(self, name_or_number: str | int) -> Column | None:
        """Return a column by number, heading, or name without unit; None if not unique."""
        if isinstance(name_or_number, int):
            matches = [c for c in self.columns if c.number == name_or_number]
        else:
            name = name_or_number.strip()
            matches = [c for c in self.columns if c.label == name]
            matches = matches or [c for c in self.columns if c.heading.stem == name]
        return matches[0] if len(matches) == 1 else None

    def si(self, name_or_number: str | int) -> Array:
        """Return a column's values in SI units, with NaN for missing numbers."""
        column = self.find(name_or_number)
        if column is None:
            columns = ", ".join(repr(c.label) if c.label else str(c.number) for c in self.columns)
            raise RecordingError(
                f"{self.name}: no single column {name_or_number!r} among {columns}",
                needed="the heading or the number (from 1) of one column",
                remedy="Name the column as the file does, or give its number.",
            )
        return column.si_values

    def row_name(self, row: int) -> str:
        """Name a row in messages: its line in a text file, its number elsewhere."""
        row = self.rows - 1 - row if self.is_reversed else row
        if self.first_line:
            return f"line {self.first_line + row}"
        return f"row {self.first_row + row + 1}"

    def row_names(self, rows: NDArray[np.intp]) -> Callable[[int], str]:
        """Return a function from k to the name of the k-th of some rows in messages."""
        return lambda k: self.row_name(int(rows[k]))

    def reversed(self) -> "RawTable":
        """Return the table in reverse order, for files with the newest row first."""
        return replace(
            self,
            columns=tuple(replace(c, values=c.values[::-1]) for c in self.columns),
            segment_starts=tuple(sorted(self.rows - start for start in self.segment_starts)),
            is_reversed=not self.is_reversed,
        )

    def followed_by(self, table: "RawTable") -> "RawTable":
        """Return this table with the rows of the next part of its file."""
        is_adjacent = table.first_line == self.first_line + self.rows
        return replace(
            self,
            columns=tuple(
                replace(column, values=np.concatenate([column.values, further.values]))
                for column, further in zip(self.columns, table.columns, strict=True)
            ),
            segment_starts=(
                *self.segment_starts,
                *(self.rows + start for start in table.segment_starts),
            ),
            first_line=self.first_line if is_adjacent else 0,
            statements=(*self.statements, *table.statements),
        )

    def part(self, rows: slice, name: str) -> "RawTable":
        """Return some rows as a table with another name."""
        first, stop = rows.start, rows.stop
        ahead = self.rows - stop if self.is_reversed else first
        return replace(
            self,
            name=name,
            columns=tuple(replace(c, values=c.values[rows]) for c in self.columns),
            segment_starts=tuple(s - first for s in self.segment_starts if first < s < stop),
            first_line=self.first_line and self.first_line + ahead,
            first_row=self.first_row + ahead,
        )
