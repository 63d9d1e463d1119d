"""Labels of an axis: round, inside the axis, accurate, not too many."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid_reports.chart import decade_ticks, even_ticks
from piezoid_reports.quantities import MINUS


def _number(label: str) -> float:
    return float(label.replace(MINUS, "-"))


@given(st.floats(-16.0, 8.0), st.floats(1e-3, 16.0))
def test_a_logarithmic_label_is_the_number_at_its_position(low, span):
    for position, label in decade_ticks(low, low + span):
        assert low - 1e-6 <= position <= low + span + 1e-6
        # Between neighbouring decades labels have the digits of an even step.
        assert math.log10(_number(label)) == pytest.approx(position, abs=1e-3)


@given(st.floats(-16.0, 8.0), st.floats(0.05, 16.0))
def test_a_logarithmic_axis_has_3_to_18_labels(low, span):
    assert 3 <= len(decade_ticks(low, low + span)) <= 18


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (0.0, 4.0, ["1", "10", "100", "1000", "10000"]),
        (0.9, 2.1, ["10", "20", "50", "100"]),
        (-2.0, 1.0, ["0.01", "0.1", "1", "10"]),
        (-13.0, -10.9, [f"1e{MINUS}13", f"1e{MINUS}12", f"1e{MINUS}11"]),
        (2.0, 2.1, ["100", "105", "110", "115", "120", "125"]),
    ],
)
def test_decades_have_round_labels(low, high, labels):
    assert [label for _, label in decade_ticks(low, high)] == labels


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_even_labels_are_the_numbers_at_their_positions(low, span):
    ticks = even_ticks(low, low + span)
    assert 3 <= len(ticks) <= 8
    for position, label in ticks:
        assert _number(label) == pytest.approx(position, rel=1e-6, abs=1e-9 * abs(low) + 1e-12)
