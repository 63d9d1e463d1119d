"""What a record does to its arrays."""

from dataclasses import dataclass

import numpy as np
import pytest

from piezoid.numerics.arrays import (
    Array,
    expect_shapes,
    freeze,
    frozen,
    same_length,
    spread_rows,
    strictly_increasing,
)


def test_what_is_wrong_with_an_array_is_told_with_its_first_place() -> None:
    with pytest.raises(ValueError, match=r"\[1\] = 2.0, \[2\] = 2.0"):
        strictly_increasing(np.array([1.0, 2.0, 2.0, 1.0]), "x")
    strictly_increasing(np.array([1.0, 1.0 + 1e-15]), "x")
    strictly_increasing(np.array([-1e308, 1e308]), "x")
    with pytest.raises(ValueError, match="c has 1 values, a has 2"):
        same_length([("a", np.ones(2)), ("b", np.ones(2)), ("c", np.ones(1))])


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    row: Array
    table: Array

    def __post_init__(self) -> None:
        freeze(self, "row")
        freeze(self, "table", ndim=2)
        expect_shapes(self, {"row": (3,), "table": (3, 2)})


def test_a_record_holds_copies_of_the_arrays_it_was_given() -> None:
    row, table = np.ones(3), np.ones((2, 3)).T
    held = Held(row=row, table=table)
    row[0] = table[0, 0] = 7.0
    assert held.row[0] == held.table[0, 0] == 1.0
    assert held.table.flags.c_contiguous
    for array in (held.row, held.table):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    assert frozen([[1, 2]], "x", ndim=2).dtype == np.float64


def test_a_record_names_the_field_whose_axes_values_or_shape_are_wrong() -> None:
    with pytest.raises(ValueError, match="table has 1 axes, expected 2"):
        Held(row=np.ones(3), table=np.ones(3))
    with pytest.raises(ValueError, match=r"row\[2\] is nan, expected finite"):
        Held(row=np.array([0.0, 1.0, np.nan]), table=np.ones((3, 2)))
    with pytest.raises(ValueError, match=r"table has shape \(2, 3\), expected \(3, 2\)"):
        Held(row=np.ones(3), table=np.ones((2, 3)))


@pytest.mark.parametrize("most", [1000, 5000, 8000])
def test_spread_rows_tell_harmonics_of_a_hum_apart(most: int) -> None:
    rows = spread_rows(20_000, most)
    assert 0.85 * most < len(rows) <= most
    turn = 2.0 * np.pi * 50.0 * rows / 500.0
    lines = np.column_stack([wave(n * turn) for n in (1, 2, 3) for wave in (np.cos, np.sin)])
    assert np.linalg.cond(lines) < 1.3  # at every fourth row sines vanish, and 50 Hz is 150 Hz
