"""Records copy, freeze and check their arrays."""

from dataclasses import dataclass

import numpy as np
import pytest

from piezoid.numerics.arrays import (
    Array,
    expect_shapes,
    freeze,
    same_length,
    spread_rows,
    strictly_increasing,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    row: Array
    table: Array

    def __post_init__(self) -> None:
        freeze(self, "row")
        freeze(self, "table", ndim=2)
        expect_shapes(self, {"row": (3,), "table": (3, 2)})
        strictly_increasing(self.row, "row")
        same_length([("row", self.row), ("table", self.table)])


ROW = np.array([-1e308, 1.0, 1e308])


def test_a_record_has_read_only_copies_of_its_arrays():
    row, table = ROW.copy(), np.ones((2, 3)).T
    record = Record(row=row, table=table)
    row[1] = table[0, 0] = 7.0
    assert record.row[1] == record.table[0, 0] == 1.0
    assert record.table.flags.c_contiguous
    for array in (record.row, record.table):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("row", "table", "message"),
    [
        (ROW, np.ones(3), "table has 1 axes, expected 2"),
        ([0.0, 1.0, np.nan], np.ones((3, 2)), r"row\[2\] is nan, expected finite"),
        (ROW, np.ones((2, 3)), r"table has shape \(2, 3\), expected \(3, 2\)"),
        ([1.0, 2.0, 2.0], np.ones((3, 2)), r"\[1\] = 2.0, \[2\] = 2.0"),
    ],
)
def test_an_invalid_array_is_named(row, table, message):
    with pytest.raises(ValueError, match=message):
        Record(row=np.array(row), table=table)


def test_unequal_lengths_are_named():
    with pytest.raises(ValueError, match="c has 1 values, a has 2"):
        same_length([("a", np.ones(2)), ("b", np.ones(2)), ("c", np.ones(1))])


@pytest.mark.parametrize("max_rows", [1000, 5000, 8000])
def test_spread_rows_resolve_harmonics_of_mains_hum(max_rows):
    rows = spread_rows(20_000, max_rows)
    assert 0.85 * max_rows < len(rows) <= max_rows
    phase = 2.0 * np.pi * 50.0 * rows / 500.0
    columns = np.column_stack([wave(n * phase) for n in (1, 2, 3) for wave in (np.cos, np.sin)])
    assert np.linalg.cond(columns) < 1.3  # every fourth row would alias 50 Hz and 150 Hz
