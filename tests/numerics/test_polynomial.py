"""Polynomials in q^-1 by examples, and the Bezout equation on random plants with fixed parts.

Laws that hold for every polynomial stand in test_laws_of_polynomials.
"""

import numpy as np
import pytest

from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import (
    delayed,
    from_roots,
    product,
    roots_of,
    solve_bezout,
    spectral_radius,
    total,
    trimmed,
    value_at,
)

ROUNDING = 1e-12


def random_polynomial(rng: np.random.Generator, order: int, radius: float) -> Array:
    """Draw a monic polynomial with real roots and conjugate pairs inside a radius."""
    roots: list[complex] = []
    while len(roots) < order:
        size = radius * np.sqrt(rng.uniform(0.01, 1.0))
        if order - len(roots) >= 2 and rng.uniform() < 0.5:
            root = size * np.exp(1j * rng.uniform(0.1, 3.0))
            roots += [root, root.conjugate()]
        else:
            roots.append(size * rng.choice([-1.0, 1.0]))
    return from_roots(roots)


def test_the_value_at_one_is_the_sum(rng):
    p = random_polynomial(rng, 4, 0.9)
    assert value_at(p, 1.0).real == pytest.approx(p.sum(), rel=ROUNDING)


def test_a_sum_takes_any_degrees_and_zeros_at_the_end_are_no_degree():
    np.testing.assert_array_equal(total([1.0, 2.0], [0.0, 0.0, 3.0]), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(trimmed([1.0, 2.0, 0.0]), [1.0, 2.0])
    np.testing.assert_array_equal(trimmed([0.0, 0.0]), [0.0])


def test_leading_zeros_are_a_delay_and_no_roots():
    assert roots_of([0.0, 0.0, 1.0, -0.5]) == pytest.approx([0.5])
    assert spectral_radius([3.0]) == 0.0


def random_problem(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Draw A H_S, B H_R and P; nothing keeps poles and zeros apart."""
    a = random_polynomial(rng, int(rng.integers(1, 6)), 0.98)
    zeros = random_polynomial(rng, int(rng.integers(0, 4)), 1.3)
    w_hum = 2.0 * np.pi * rng.uniform(50.0, 1000.0) / 20e3
    hum = [1.0, -2.0 * np.cos(w_hum), 1.0] if rng.uniform() < 0.3 else [1.0]
    fixed_a = product(a, [1.0, -1.0], hum)
    nyquist = [1.0, 1.0] if rng.uniform() < 0.7 else [1.0]
    late = int(rng.integers(1, 4))
    fixed_b = delayed(product([10.0 ** rng.uniform(-7, 3)], zeros, nyquist), late)
    order = int(rng.integers(1, len(fixed_a) + len(fixed_b) - 2))
    return fixed_a, fixed_b, random_polynomial(rng, order, 0.9)


def test_bezout_is_solved_to_rounding_of_its_own_terms_on_200_random_problems(rng):
    for _ in range(200):
        a, b, p = random_problem(rng)
        solution = solve_bezout(a, b, p)
        left = total(np.convolve(a, solution.S), np.convolve(b, solution.R), -p)
        terms = np.convolve(abs(a), abs(solution.S)).max() + np.abs(p).max()
        assert np.abs(left).max() <= ROUNDING * terms
        assert len(solution.R) == len(a) - 1


def test_the_residual_of_bezout_is_beside_the_largest_coefficient_asked_for(rng):
    for size in (1.0, -1e3, 1e-3) * 8:
        a, b, p = random_problem(rng)
        solution = solve_bezout(a, b, size * p)
        left = total(np.convolve(a, solution.S), np.convolve(b, solution.R), -size * p)
        beside = np.abs(left).max() / np.abs(size * p).max()
        assert solution.residual == pytest.approx(beside, rel=0.01, abs=0.0)
        assert 0.0 <= solution.residual < 1e-6


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
