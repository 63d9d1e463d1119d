"""What a record does to its arrays."""

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
class Held:
    row: Array
    table: Array

    def __post_init__(self) -> None:
        freeze(self, "row")
        freeze(self, "table", ndim=2)
        expect_shapes(self, {"row": (3,), "table": (3, 2)})
        strictly_increasing(self.row, "row")
        same_length([("row", self.row), ("table", self.table)])


ROW = np.array([-1e308, 1.0, 1e308])


def test_a_record_holds_read_only_copies_of_the_arrays_it_was_given() -> None:
    row, table = ROW.copy(), np.ones((2, 3)).T
    held = Held(row=row, table=table)
    row[1] = table[0, 0] = 7.0
    assert held.row[1] == held.table[0, 0] == 1.0
    assert held.table.flags.c_contiguous
    for array in (held.row, held.table):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize(
    ("row", "table", "told"),
    [
        (ROW, np.ones(3), "table has 1 axes, expected 2"),
        ([0.0, 1.0, np.nan], np.ones((3, 2)), r"row\[2\] is nan, expected finite"),
        (ROW, np.ones((2, 3)), r"table has shape \(2, 3\), expected \(3, 2\)"),
        ([1.0, 2.0, 2.0], np.ones((3, 2)), r"\[1\] = 2.0, \[2\] = 2.0"),
    ],
)
def test_a_record_names_the_field_whose_axes_values_shape_or_order_are_wrong(
    row: Array, table: Array, told: str
) -> None:
    with pytest.raises(ValueError, match=told):
        Held(row=np.array(row), table=table)


def test_arrays_of_unequal_length_are_told_with_their_lengths() -> None:
    with pytest.raises(ValueError, match="c has 1 values, a has 2"):
        same_length([("a", np.ones(2)), ("b", np.ones(2)), ("c", np.ones(1))])


@pytest.mark.parametrize("most", [1000, 5000, 8000])
def test_spread_rows_tell_harmonics_of_a_hum_apart(most: int) -> None:
    rows = spread_rows(20_000, most)
    assert 0.85 * most < len(rows) <= most
    turn = 2.0 * np.pi * 50.0 * rows / 500.0
    lines = np.column_stack([wave(n * turn) for n in (1, 2, 3) for wave in (np.cos, np.sin)])
    assert np.linalg.cond(lines) < 1.3  # at every fourth row sines vanish, and 50 Hz is 150 Hz
