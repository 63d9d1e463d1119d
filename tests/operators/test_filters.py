"""A signal some samples later: read off a picture of it, row by row."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezoid.operators.filters import lagged, later

SIXTEENTHS = st.integers(0, 40 * 16).map(lambda count: count / 16)


@given(
    st.binary(min_size=1, max_size=30),
    SIXTEENTHS,
    st.tuples(st.integers(0, 30), st.integers(0, 30), st.integers(1, 7)),
)
def test_every_row_to_keep_lies_on_the_straight_line_that_many_samples_before(
    numbers: bytes, samples: float, rows: tuple[int, int, int]
) -> None:
    moved, keep = np.frombuffer(numbers, np.int8) / 16, slice(*rows)
    place = np.arange(len(moved))
    # Before the first sample it stood where the first sample is. Sixteenths round nothing.
    expected = np.interp(place - samples, place, moved)[keep]
    np.testing.assert_array_equal(later(moved, samples, keep), expected)
    np.testing.assert_array_equal(lagged(moved, "delay", samples / 8, 8.0, keep=keep), expected)
    both = np.column_stack([moved, -moved])
    np.testing.assert_array_equal(
        later(both, samples, keep), np.column_stack([expected, -expected])
    )
