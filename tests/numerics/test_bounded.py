"""Bounded quadratic forms: against a solver of other make, and the conditions of an optimum."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_minimum


def expect_optimum(found: Array, slope: Array, lower: Array, upper: Array) -> None:
    """The cost falls only in directions that a bound forbids."""
    assert ((lower <= found) & (found <= upper)).all()
    assert (slope[found > lower] <= 1e-9).all()
    assert (slope[found < upper] >= -1e-9).all()


@pytest.mark.parametrize("seed", range(6))
def test_the_minimum_is_the_one_that_another_solver_finds(seed: int) -> None:
    chance = np.random.default_rng(seed)
    rows = chance.standard_normal((60, 25)) @ np.diag(np.geomspace(1.0, 1e-2, 25))
    rows += 0.8 * rows[:, :1]  # alike, as columns of plays are
    target = chance.standard_normal(60)
    lower, upper = -chance.uniform(0.0, 0.3, 25), chance.uniform(0.0, 0.3, 25)
    lower[3] = upper[3] = 0.1
    lower[7], upper[9] = -np.inf, np.inf
    found = bounded_minimum(rows.T @ rows, rows.T @ target, lower, upper)
    wide = np.maximum(upper, lower + 1e-12)
    other = lsq_linear(rows, target, (lower, wide), method="bvls", tol=1e-14).x
    cost = [np.sum((rows @ x - target) ** 2) for x in (found, other)]
    assert cost[0] <= cost[1] * (1 + 1e-9)
    assert ((lower <= found) & (found <= upper)).all()


@given(seed=st.integers(0, 2**32 - 1), power=st.integers(-60, 60))
def test_nothing_is_small_or_large_by_itself(seed: int, power: int) -> None:
    chance, unit = np.random.default_rng(seed), 10.0**power
    rows = chance.standard_normal((40, 1)) + 0.3 * chance.standard_normal((40, 10))
    gram, right = rows.T @ rows / 40, rows.T @ chance.standard_normal(40) / 40
    lower, upper = -chance.uniform(0.0, 0.5, 10), chance.uniform(0.0, 0.5, 10)
    known = bounded_minimum(gram, right, lower, upper)
    numbers = bounded_minimum(gram, unit * right, unit * lower, unit * upper) / unit
    np.testing.assert_allclose(numbers, known, atol=1e-12)
    whole = bounded_minimum(unit * gram, unit * right, lower, upper)
    np.testing.assert_allclose(whole, known, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), power=st.integers(-60, 60))
def test_bounds_at_zero_are_guessed_and_let_go_where_the_guess_was_wrong(
    seed: int, power: int
) -> None:
    chance, unit = np.random.default_rng(seed), 10.0**power
    rows = chance.standard_normal((40, 10)) + chance.uniform(-2, 2) * chance.standard_normal(
        (40, 1)
    )
    gram, right = rows.T @ rows, unit * (rows.T @ chance.standard_normal(40))
    side = chance.integers(0, 3, 10)
    lower, upper = np.where(side == 0, 0.0, -unit), np.where(side == 1, 0.0, unit)
    found = bounded_minimum(gram, right, lower, upper)
    expect_optimum(found, (gram @ found - right) / unit, lower, upper)


@pytest.mark.parametrize("seed", range(6))
def test_columns_much_alike_are_told_apart(seed: int) -> None:
    """Of 387 such steps in the fit of one stage block pivoting had left two far from a minimum."""
    chance = np.random.default_rng(seed)
    rows = np.cumsum(chance.standard_normal((400, 120)), axis=1)
    rows /= np.linalg.norm(rows, axis=0)
    gram, right = rows.T @ rows + 1e-9 * np.eye(120), rows.T @ chance.standard_normal(400)
    lower, upper = -chance.uniform(0.0, 0.5, 120), chance.uniform(0.0, 0.5, 120)
    found = bounded_minimum(gram, right, lower, upper)
    expect_optimum(found, (gram @ found - right) / np.linalg.norm(right), lower, upper)


def test_a_form_that_is_not_definite_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="daqp"):
        bounded_minimum(np.diag([1.0, -1.0]), np.ones(2), -np.ones(2), np.ones(2))
