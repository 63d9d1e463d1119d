"""Laws of polynomials in q^-1 and of the Bezout equation."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import (
    decibel,
    delayed,
    from_roots,
    grid_Hz,
    polynomial_response,
    product,
    roots_of,
    solve_bezout,
    spectral_radius,
    total,
    unit_circle,
)


def coefficients(min_terms: int = 1, max_terms: int = 8) -> st.SearchStrategy[Array]:
    """Draw integers, some zero at the ends, whose sums and products are exact."""
    return st.binary(min_size=min_terms, max_size=max_terms).map(
        lambda data: np.frombuffer(data, np.int8).astype(np.float64)
    )


@st.composite
def stable_roots(draw: st.DrawFn, max_roots: int = 6) -> Array:
    """Draw separate roots within 0.9, complex roots in pairs."""
    data = np.frombuffer(draw(st.binary(min_size=2, max_size=max_roots)), np.uint8)
    roots: list[complex] = []
    for number, byte in enumerate(data):
        size = 0.1 + 0.8 * number / max_roots
        if byte < 128 and len(roots) + 2 <= max_roots:
            root = size * np.exp(1j * (0.1 + byte / 45))
            roots += [root, root.conjugate()]
        elif len(roots) < max_roots:
            roots.append(size if byte % 2 else -size)
    return np.array(roots)


POINTS = st.floats(0.5, 2.0).flatmap(
    lambda size: st.floats(0.0, 3.1).map(lambda turn: complex(size * np.exp(1j * turn)))
)


def value_at(polynomial: Array, z: complex) -> complex:
    """Return p[0] + p[1]/z + ..."""
    return complex(np.polyval(polynomial[::-1], 1.0 / z))


@given(coefficients(), coefficients(), st.integers(0, 5), POINTS)
def test_values_multiply_add_and_are_delayed(a, b, delay, z):
    at_a, at_b = value_at(a, z), value_at(b, z)
    size = 128.0**2 * 64 * 2.0**14
    np.testing.assert_allclose(value_at(product(a, b), z), at_a * at_b, atol=1e-15 * size)
    np.testing.assert_allclose(value_at(total(a, b), z), at_a + at_b, atol=1e-15 * size)
    np.testing.assert_allclose(value_at(delayed(a, delay), z), at_a / z**delay, atol=1e-15 * size)


@given(coefficients(), st.floats(0.0, 1e4))
def test_a_response_is_the_value_on_the_unit_circle(a, frequency_Hz):
    z = np.exp(2j * np.pi * frequency_Hz / 2e4)
    response = polynomial_response(a, unit_circle([frequency_Hz], 2e4))
    np.testing.assert_allclose(response, [value_at(a, z)], atol=1e-10)


@given(stable_roots(), st.integers(0, 3))
def test_roots_and_spectral_radius_are_recovered(roots, delay):
    polynomial = from_roots(roots)
    assert polynomial[0] == 1.0
    assert not np.iscomplexobj(polynomial)
    estimates = roots_of(delayed(3.0 * polynomial, delay))
    distance = np.abs(estimates[:, None] - roots)
    assert distance.min(axis=0).max() < 1e-6
    assert distance.min(axis=1).max() < 1e-6
    assert spectral_radius(polynomial) == pytest.approx(np.abs(roots).max(), abs=1e-6)


@given(stable_roots(5), stable_roots(4), stable_roots(), st.integers(1, 3), st.integers(-9, 4))
def test_bezout_places_the_poles_for_gains_of_every_size(
    poles, zeros, closed_loop_poles, delay, power
):
    assume(np.abs(poles[:, None] - zeros * 1.05).min() > 0.02)
    A, P = from_roots(poles), from_roots(closed_loop_poles)
    B = delayed(10.0**power * from_roots(zeros * 1.05), delay)
    solution = solve_bezout(A, B, P)
    size = np.convolve(np.abs(A), np.abs(solution.S)).max()
    closed_loop = total(product(A, solution.S), product(B, solution.R))
    np.testing.assert_allclose(
        closed_loop, total(P, np.zeros(len(closed_loop))), atol=1e-12 * (size + np.abs(P).max())
    )
    assert len(solution.R) == len(A) - 1
    assert solution.residual == pytest.approx(
        np.abs(total(closed_loop, -P)).max() / np.abs(P).max(), abs=1e-13 * size
    )
    scaled = solve_bezout(A, B * 2.0**-20, P)
    np.testing.assert_array_equal(scaled.S, solution.S)
    np.testing.assert_array_equal(scaled.R * 2.0**-20, solution.R)
    assert scaled.condition == solution.condition >= 1.0


@given(stable_roots(4), stable_roots(4), stable_roots(2))
def test_a_common_root_of_plant_and_numerator_is_refused(poles, zeros, common):
    A = from_roots(np.concatenate([poles, common]))
    B = delayed(from_roots(np.concatenate([zeros, common])), 1)
    with pytest.raises(DesignError, match="nearly cancel") as refusal:
        solve_bezout(A, B, [1.0])
    pole, zero = refusal.value.numbers["pole"], refusal.value.numbers["zero"]
    assert abs(pole - zero) < 1e-3
    assert np.abs(np.concatenate([poles, common]) - pole).min() < 1e-3


def test_a_plant_without_numerator_is_refused():
    with pytest.raises(ValueError, match="non-zero B"):
        solve_bezout([1.0, -0.5], [0.0], [1.0])


def test_grid_and_decibels_have_known_values():
    grid = grid_Hz(2e4, lowest_Hz=0.5, count=300)
    assert (np.diff(grid) > 0).all()
    assert grid[0] == pytest.approx(0.5)
    assert 0.4998 * 2e4 < grid[-1] < 0.5 * 2e4
    assert 290 <= len(grid) <= 300
    assert decibel(2.0) == pytest.approx(6.0206, abs=1e-4)
    assert decibel(0.0) == -np.inf
