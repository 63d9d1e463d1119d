"""Polynomials in q^-1 and the Bezout equation by examples.

Laws that hold for every polynomial stand in test_laws_of_polynomials.
"""

import numpy as np
import pytest

from piezoid.errors import DesignError
from piezoid.numerics.polynomial import (
    from_roots,
    roots_of,
    solve_bezout,
    spectral_radius,
)

ROUNDING = 1e-12


def test_leading_zeros_are_a_delay_and_no_roots():
    assert roots_of([0.0, 0.0, 1.0, -0.5]) == pytest.approx([0.5])
    assert spectral_radius([3.0]) == 0.0


def test_a_target_of_high_degree_makes_s_longer_and_not_r():
    a, b = np.array([1.0, -1.5, 0.56]), np.array([0.0, 1.0, 0.5])
    p = from_roots(np.full(7, 0.3))
    solution = solve_bezout(a, b, p)
    assert (len(solution.S), len(solution.R)) == (6, 2)
    assert solution.residual <= ROUNDING


def test_a_plant_of_first_order_needs_no_more_than_two_numbers():
    solution = solve_bezout([1.0, -0.5], [0.0, 2.0], [1.0, -0.2])
    np.testing.assert_allclose(solution.S, [1.0])
    np.testing.assert_allclose(solution.R, [0.15])


def test_a_common_root_is_refused_by_its_value():
    a, b = from_roots([0.5, 0.25]), np.convolve([0.0, 1.0], [1.0, -0.5])
    told = r"pole z = 0\.5.*zero z = 0\.5.*in the ratio (0\.0e\+00|\d\.\de-(1[4-9]|[2-9]\d))"
    with pytest.raises(DesignError, match=told) as refusal:
        solve_bezout(a, b, [1.0])
    assert refusal.value.numbers["pole"] == pytest.approx(0.5)


def test_a_plant_without_numerator_is_a_programmers_error():
    with pytest.raises(ValueError, match="non-zero B"):
        solve_bezout([1.0, -0.5], [0.0], [1.0])
