"""Numbers for readers: prefix, digits by the interval, no exponent."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid.formatting import PREFIXES, UNKNOWN
from piezoid_reports.quantities import MINUS, number, significant, with_half_width, with_interval

FACTOR = {prefix: factor for factor, prefix in PREFIXES}


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (6.604e-8, "m", "66.0 nm"),
        (3.367e-5, "m", "33.7 µm"),
        (9.996e-7, "m", "1.00 µm"),
        (0.0, "V", "0 V"),
        (-5.0, "V", f"{MINUS}5.00 V"),
        (0.0196, "%", "0.0196 %"),
        (2.75e-6, "m/V", "2.75 µm/V"),
        (1.0, "", "1.00"),
        (1570.0, "V/s", "1.57 kV/s"),
        (math.nan, "m", UNKNOWN),
        (math.inf, "m", UNKNOWN),
    ],
)
def test_a_number_has_a_prefix_and_three_digits(value, unit, text):
    assert number(value, unit).replace("\u202f", " ") == text


@given(st.floats(1e-11, 1e8))
def test_formatted_digits_lie_between_one_and_a_thousand(value):
    digits, _, unit = number(value, "m").partition("\u202f")
    assert float(digits) * FACTOR[unit[:-1]] == pytest.approx(value, rel=5.1e-3)
    assert 0.999 <= float(digits) < 1000 or value > 999e6


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (2.749e-6, 1.24e-8, "(2.749 ± 0.012) µm/V"),
        (-4.2e-8, 3e-7, f"({MINUS}42 ± 300) nm/V"),
        (1e-9, 0.0, "1.000 nm/V (fixed)"),
        (1e-9, math.nan, "1.00 nm/V"),
    ],
)
def test_an_interval_has_the_unit_of_its_number(value, half, text):
    assert with_half_width(value, half, "m/V").replace("\u202f", " ") == text
    assert with_half_width(0.17, 0.13, "").replace("\u202f", " ") == "0.17 ± 0.13"


@given(st.floats(-1e6, 1e6))
def test_significant_digits_are_accurate(value):
    read_back = float(significant(value, 4).replace(MINUS, "-"))
    assert read_back == pytest.approx(value, rel=5.1e-4, abs=1e-300)


def test_a_value_without_any_bound_is_not_stated():
    assert "1.45" not in with_interval(1.45, (0.0, math.inf), "eV")
    assert "1.45" in with_interval(1.45, (1.2, math.inf), "eV")
