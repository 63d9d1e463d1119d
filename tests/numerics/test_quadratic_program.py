"""Least squares within bounds: against another solver, and the conditions of an optimum."""

from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import (
    bounded_minimum,
    bounded_step,
    empty_triangle,
    gather,
)
from piezoid.operators.play import play_columns


def play_problem(rng: np.random.Generator, plays: int) -> tuple[Array, Array]:
    """Regressors whose Gram matrix is nearly singular, as plays' are."""
    t = np.linspace(0, 1, 20000)
    drive = (1 - t) * np.sin(40 * np.pi * t)
    columns, _ = play_columns(drive, np.arange(plays) / plays, np.zeros(plays))
    weight = np.where(rng.random(plays) < 0.3, 0.0, rng.uniform(0, 1, plays))
    return columns, columns @ weight + rng.normal(0, 1e-3, len(drive))


def reduced(columns: Array, target: Array) -> tuple[Array, Array]:
    triangle = empty_triangle(columns.shape[1] + 1)
    for chunk in np.array_split(np.column_stack([columns, target]), 7):
        triangle = gather(triangle, chunk)
    return triangle[:, :-1], triangle[:, -1]


def test_nonnegative_weights_are_those_of_all_rows(rng: np.random.Generator) -> None:
    columns, target = play_problem(rng, 40)
    found = bounded_step(*reduced(columns, target), np.zeros(40), np.full(40, np.inf))
    np.testing.assert_allclose(found, nnls(columns, target)[0], atol=1e-11)


@given(
    seed=st.integers(0, 2**32 - 1),
    power=st.integers(-60, 60),
    apart=st.sampled_from([1.0, 0.3, 1e-2]),
    asked=st.sampled_from([-0.5, 0.0, 0.2]),
)
def test_a_step_in_other_units_is_the_same_step(
    seed: int, power: int, apart: float, asked: float
) -> None:
    # Columns much alike: what a bound holds back, the others take over, some onto their bounds.
    rng, unit = np.random.default_rng(seed), 10.0**power
    columns = rng.normal(size=(80, 1)) + apart * rng.normal(size=(80, 10))
    factor, right = reduced(columns, columns @ rng.normal(size=10) + rng.normal(size=80))
    lower, upper = np.full(10, -0.5), rng.uniform(0.3, 1.0, 10)
    lower[3], upper[4] = asked, np.inf
    known = bounded_step(factor, right, lower, upper)
    found = bounded_step(factor, unit * right, unit * lower, unit * upper)
    np.testing.assert_allclose(found / unit, known, atol=1e-11)
    other_columns = bounded_step(unit * factor, right, lower / unit, upper / unit)
    np.testing.assert_allclose(other_columns * unit, known, atol=1e-11)


def test_a_step_towards_nothing_goes_as_far_as_the_bounds_ask() -> None:
    none = np.full(2, np.inf)
    for unit in (1e-40, 1e-13, 1.0, 1e40):
        asked = unit * np.array([1.0, -1.0])
        # Along (1, 1) nothing is felt: the second number makes good what the first must do.
        factor = np.array([[1.0, 1.0], [0.0, 0.1]])
        found = bounded_step(factor, np.zeros(2), asked, none) / unit
        np.testing.assert_allclose(found, [1.0, -1.0 / 1.01], rtol=1e-12)
        assert not bounded_step(factor, np.zeros(2), -abs(asked), none).any()


def test_a_step_along_columns_almost_the_same_meets_the_conditions_of_an_optimum(
    rng: np.random.Generator,
) -> None:
    """R'R cannot tell the columns apart; what is free or held must come from R."""
    columns = rng.normal(size=(300, 1)) + 1e-9 * rng.normal(size=(300, 12))
    factor, right = reduced(columns, columns @ rng.uniform(-1, 1, 12))
    lower, upper = np.full(12, -0.3), np.full(12, 0.3)
    x = bounded_step(factor, right, lower, upper)
    slope = factor.T @ (factor @ x - right) / np.linalg.norm(right)
    assert ((x >= lower) & (x <= upper)).all()
    assert (slope[x < upper] > -1e-9).all()
    assert (slope[x > lower] < 1e-9).all()


def test_a_triangle_gathered_in_chunks_holds_the_norm_of_every_combination(
    rng: np.random.Generator,
) -> None:
    rows = rng.normal(size=(1000, 6))
    triangle = empty_triangle(6)
    for chunk in np.array_split(rows, 13):
        triangle = gather(triangle, chunk)
    np.testing.assert_array_equal(gather(triangle, np.empty((0, 6))), triangle)
    assert gather(empty_triangle(0), np.empty((5, 0))).shape == (0, 0)
    x = rng.normal(size=6)
    assert np.linalg.norm(triangle @ x) == pytest.approx(np.linalg.norm(rows @ x), rel=1e-13)
    assert np.allclose(triangle, np.triu(triangle))


@pytest.mark.parametrize("order", ["C", "F"])
def test_rows_that_are_gathered_stay_as_they_are_unless_they_may_be_spent(
    rng: np.random.Generator, order: Literal["C", "F"]
) -> None:
    rows = np.asarray(rng.normal(size=(50, 3)), order=order)
    before = rows.copy()
    kept = gather(empty_triangle(3), rows)
    np.testing.assert_array_equal(rows, before)
    np.testing.assert_array_equal(gather(empty_triangle(3), rows, spend=True), kept)


def expect_optimum(found: Array, slope: Array, lower: Array, upper: Array) -> None:
    """The cost falls only in directions that a bound forbids."""
    assert ((lower <= found) & (found <= upper)).all()
    assert (slope[found > lower] <= 1e-9).all()
    assert (slope[found < upper] >= -1e-9).all()


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


@pytest.mark.parametrize("seed", range(3))
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
