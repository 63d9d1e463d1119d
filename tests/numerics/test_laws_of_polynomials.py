"""The laws of polynomials in q^-1 and of the Bezout equation, on polynomials of every kind."""

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


def coefficients(least: int = 1, most: int = 8) -> st.SearchStrategy[Array]:
    """Whole numbers, zeros at both ends among them: sums and products are exact."""
    return st.binary(min_size=least, max_size=most).map(
        lambda found: np.frombuffer(found, np.int8).astype(np.float64)
    )


@st.composite
def stable_roots(draw: st.DrawFn, most: int = 6) -> Array:
    """Roots within 0.9, complex ones in pairs, apart enough to be found again."""
    raw = np.frombuffer(draw(st.binary(min_size=2, max_size=most)), np.uint8)
    found: list[complex] = []
    for number, byte in enumerate(raw):
        size = 0.1 + 0.8 * number / most
        if byte < 128 and len(found) + 2 <= most:
            root = size * np.exp(1j * (0.1 + byte / 45))
            found += [root, root.conjugate()]
        elif len(found) < most:
            found.append(size if byte % 2 else -size)
    return np.array(found)


POINTS = st.floats(0.5, 2.0).flatmap(
    lambda size: st.floats(0.0, 3.1).map(lambda turn: complex(size * np.exp(1j * turn)))
)


def value_at(polynomial: Array, z: complex) -> complex:
    """Return p[0] + p[1]/z + ..."""
    return complex(np.polyval(polynomial[::-1], 1.0 / z))


@given(coefficients(), coefficients(), st.integers(0, 5), POINTS)
def test_values_multiply_add_and_are_delayed(a: Array, b: Array, late: int, z: complex) -> None:
    at_a, at_b = value_at(a, z), value_at(b, z)
    size = 128.0**2 * 64 * 2.0**14
    np.testing.assert_allclose(value_at(product(a, b), z), at_a * at_b, atol=1e-15 * size)
    np.testing.assert_allclose(value_at(total(a, b), z), at_a + at_b, atol=1e-15 * size)
    np.testing.assert_allclose(value_at(delayed(a, late), z), at_a / z**late, atol=1e-15 * size)


@given(coefficients(), st.floats(0.0, 1e4))
def test_a_response_is_the_value_on_the_unit_circle(a: Array, frequency_Hz: float) -> None:
    z = np.exp(2j * np.pi * frequency_Hz / 2e4)
    found = polynomial_response(a, unit_circle([frequency_Hz], 2e4))
    np.testing.assert_allclose(found, [value_at(a, z)], atol=1e-10)


@given(stable_roots(), st.integers(0, 3))
def test_roots_come_back_and_tell_stability(roots: Array, late: int) -> None:
    polynomial = from_roots(roots)
    assert polynomial[0] == 1.0
    assert not np.iscomplexobj(polynomial)
    found = roots_of(delayed(3.0 * polynomial, late))
    apart = np.abs(found[:, None] - roots)
    assert apart.min(axis=0).max() < 1e-6
    assert apart.min(axis=1).max() < 1e-6
    assert spectral_radius(polynomial) == pytest.approx(np.abs(roots).max(), abs=1e-6)


@given(stable_roots(5), stable_roots(4), stable_roots(), st.integers(1, 3), st.integers(-9, 4))
def test_bezout_places_what_it_is_told_for_gains_of_every_size(
    poles: Array, zeros: Array, wanted: Array, late: int, power: int
) -> None:
    assume(np.abs(poles[:, None] - zeros * 1.05).min() > 0.02)
    A, P = from_roots(poles), from_roots(wanted)
    B = delayed(10.0**power * from_roots(zeros * 1.05), late)
    solution = solve_bezout(A, B, P)
    size = np.convolve(np.abs(A), np.abs(solution.S)).max()
    left = total(product(A, solution.S), product(B, solution.R))
    np.testing.assert_allclose(
        left, total(P, np.zeros(len(left))), atol=1e-12 * (size + np.abs(P).max())
    )
    assert len(solution.R) == len(A) - 1
    assert solution.residual == pytest.approx(
        np.abs(total(left, -P)).max() / np.abs(P).max(), abs=1e-13 * size
    )
    plain = solve_bezout(A, B * 2.0**-20, P)
    np.testing.assert_array_equal(plain.S, solution.S)
    np.testing.assert_array_equal(plain.R * 2.0**-20, solution.R)
    assert plain.condition == solution.condition >= 1.0


@given(stable_roots(4), stable_roots(4), stable_roots(2))
def test_a_common_root_is_never_divided_by(poles: Array, zeros: Array, common: Array) -> None:
    A = from_roots(np.concatenate([poles, common]))
    B = delayed(from_roots(np.concatenate([zeros, common])), 1)
    with pytest.raises(DesignError, match="nearly cancel") as refusal:
        solve_bezout(A, B, [1.0])
    pole, zero = refusal.value.numbers["pole"], refusal.value.numbers["zero"]
    assert abs(pole - zero) < 1e-3
    assert np.abs(np.concatenate([poles, common]) - pole).min() < 1e-3


def test_a_plant_without_numerator_is_a_programmers_error() -> None:
    with pytest.raises(ValueError, match="non-zero B"):
        solve_bezout([1.0, -0.5], [0.0], [1.0])


def test_the_grid_increases_from_its_start_to_just_below_nyquist() -> None:
    grid = grid_Hz(2e4, lowest_Hz=0.5, count=300)
    assert (np.diff(grid) > 0).all()
    assert grid[0] == pytest.approx(0.5)
    assert 0.4998 * 2e4 < grid[-1] < 0.5 * 2e4
    assert 290 <= len(grid) <= 300


def test_twice_as_much_is_six_decibels_and_zero_is_minus_infinity() -> None:
    assert decibel(2.0) == pytest.approx(6.0206, abs=1e-4)
    assert decibel(0.0) == -np.inf
