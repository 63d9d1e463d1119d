"""Small convex programs against independent solvers."""

import daqp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from piezoid.errors import InfeasibleFitError
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import (
    bounded_step,
    constrained_least_squares,
    empty_triangle,
    gather,
    stationarity,
)
from piezoid.operators.play import play_columns


def play_problem(rng: np.random.Generator, plays: int) -> tuple[Array, Array]:
    """Return play regressors, whose Gram matrix is nearly singular, and a noisy target."""
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


@pytest.mark.parametrize("plays", [20, 40])
def test_nonnegative_weights_agree_with_nnls_on_all_rows(rng, plays):
    columns, target = play_problem(rng, plays)
    reference = nnls(columns, target)[0]
    factor, right = reduced(columns, target)
    unbounded, zero = np.full(plays, np.inf), np.zeros(plays)
    program = constrained_least_squares(factor, right, np.eye(plays), zero, unbounded)
    # OSQP stops at 1e-10 of its residuals; the regressors' condition of 1e4 multiplies that.
    np.testing.assert_allclose(program.x, reference, atol=1e-6)
    assert program.kkt_gap < 1e-10
    assert program.cost == pytest.approx(float(np.sum((factor @ program.x - right) ** 2)))
    np.testing.assert_allclose(bounded_step(factor, right, zero, unbounded), reference, atol=1e-11)


def test_the_gap_without_bounds_is_the_gradient_relative_to_zero(rng):
    factor, right = reduced(rng.normal(size=(60, 4)), rng.normal(size=60))
    optimum = np.linalg.lstsq(factor, right)[0]
    unbounded = np.full(4, -np.inf), np.full(4, np.inf)
    assert stationarity(factor, optimum, right, np.eye(4), unbounded) < 1e-14
    norms = np.linalg.norm(factor, axis=0)
    gradient = factor.T @ (factor @ (optimum + 0.1) - right) / norms
    gap = float(np.linalg.norm(gradient) / np.linalg.norm(factor.T @ right / norms))
    assert stationarity(factor, optimum + 0.1, right, np.eye(4), unbounded) == pytest.approx(gap)


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_the_gap_is_the_same_in_other_units(rng, unit):
    factor, right = reduced(rng.normal(size=(60, 4)), rng.normal(size=60))
    lower, upper = np.full(4, -np.inf), np.full(4, np.inf)
    optimum = bounded_step(factor, right, lower, np.array([0.0, np.inf, -0.1, np.inf]))
    upper[[0, 2]] = 0.0, -0.1
    for offset, is_optimal in ((1e-9, True), (-1e-9, True), (-1e-3, False)):
        x = optimum + np.array([offset, 0.0, 0.0, 0.0])
        gap = stationarity(factor, x, right, np.eye(4), (lower, upper))
        assert (gap < 1e-6) is is_optimal
        rescaled = stationarity(factor, unit * x, unit * right, np.eye(4), (lower, unit * upper))
        assert rescaled == pytest.approx(gap, rel=1e-3, abs=1e-12)
        rescaled_columns = stationarity(
            unit * factor, x / unit, right, np.eye(4), (lower, upper / unit)
        )
        assert rescaled_columns == pytest.approx(gap, rel=1e-3, abs=1e-12)


@given(
    seed=st.integers(0, 2**32 - 1),
    power=st.integers(-60, 60),
    spread=st.sampled_from([1.0, 0.3, 1e-2]),
    lowest=st.sampled_from([-0.5, 0.0, 0.2]),
)
def test_a_step_in_other_units_is_the_same_step(seed, power, spread, lowest):
    # With similar columns, an active bound moves other coefficients onto their bounds.
    rng, unit = np.random.default_rng(seed), 10.0**power
    columns = rng.normal(size=(80, 1)) + spread * rng.normal(size=(80, 10))
    factor, right = reduced(columns, columns @ rng.normal(size=10) + rng.normal(size=80))
    lower, upper = np.full(10, -0.5), rng.uniform(0.3, 1.0, 10)
    lower[3], upper[4] = lowest, np.inf
    expected = bounded_step(factor, right, lower, upper)
    rescaled = bounded_step(factor, unit * right, unit * lower, unit * upper)
    np.testing.assert_allclose(rescaled / unit, expected, atol=1e-11)
    rescaled_columns = bounded_step(unit * factor, right, lower / unit, upper / unit)
    np.testing.assert_allclose(rescaled_columns * unit, expected, atol=1e-11)


def test_a_step_without_a_target_moves_only_to_its_bounds():
    unbounded = np.full(2, np.inf)
    factor = np.array([[1.0, 1.0], [0.0, 0.1]])
    for unit in (1e-40, 1.0, 1e40):
        lower = unit * np.array([1.0, -1.0])
        step = bounded_step(factor, np.zeros(2), lower, unbounded) / unit
        np.testing.assert_allclose(step, [1.0, -1.0 / 1.01], rtol=1e-12)
        assert not bounded_step(factor, np.zeros(2), -abs(lower), unbounded).any()


def test_general_constraints_agree_with_an_active_set_solver(rng):
    factor, right = reduced(rng.normal(size=(200, 8)), rng.normal(size=200))
    constraint = rng.normal(size=(5, 8))
    lower, upper = np.full(5, -0.02), np.array([0.02, 0.02, np.inf, 0.01, np.inf])
    program = constrained_least_squares(factor, right, constraint, lower, upper)
    reference, _, flag, _ = daqp.solve(
        factor.T @ factor,
        -factor.T @ right,
        constraint,
        np.where(np.isinf(upper), 1e30, upper),
        lower,
        np.zeros(5, dtype=np.int32),
    )
    assert flag == 1
    np.testing.assert_allclose(program.x, reference, atol=1e-8)
    # Active constraints hold to rounding, not only to the tolerance of the iteration.
    slack = np.minimum(constraint @ program.x - lower, upper - constraint @ program.x)
    is_active = slack < 1e-6
    assert is_active.any()
    assert np.abs(slack[is_active]).max() < 1e-13


@pytest.mark.parametrize("power", [-40, -12, -3, 3, 12, 40])
@pytest.mark.parametrize("scaled_part", ["target", "columns", "rows"])
def test_a_constrained_solution_in_other_units_is_the_same_solution(rng, power, scaled_part):
    factor, right = reduced(rng.normal(size=(200, 8)), rng.normal(size=200))
    constraint, lower, upper = rng.normal(size=(5, 8)), np.full(5, -0.02), np.full(5, 0.01)
    expected = constrained_least_squares(factor, right, constraint, lower, upper).x
    unit = 10.0**power
    scales = rng.permutation([unit, 1.0, 1.0 / unit, unit, 1.0])
    solution = {
        "target": lambda u: (
            constrained_least_squares(factor, u * right, constraint, u * lower, u * upper).x / u
        ),
        "columns": lambda u: (
            constrained_least_squares(u * factor, right, constraint, lower / u, upper / u).x * u
        ),
        "rows": lambda _: (
            constrained_least_squares(
                factor, right, scales[:, None] * constraint, scales * lower, scales * upper
            ).x
        ),
    }[scaled_part](unit)
    np.testing.assert_allclose(solution, expected, atol=1e-9)


def test_a_step_along_nearly_equal_columns_is_optimal(rng):
    """R'R does not resolve the columns, so the active set must come from R."""
    columns = rng.normal(size=(300, 1)) + 1e-9 * rng.normal(size=(300, 12))
    factor, right = reduced(columns, columns @ rng.uniform(-1, 1, 12))
    lower, upper = np.full(12, -0.3), np.full(12, 0.3)
    x = bounded_step(factor, right, lower, upper)
    slope = factor.T @ (factor @ x - right) / np.linalg.norm(right)
    assert ((x >= lower) & (x <= upper)).all()
    assert (slope[x < upper] > -1e-9).all()
    assert (slope[x > lower] < 1e-9).all()


def test_contradicting_constraints_are_refused():
    constraint = np.array([[1.0], [1.0]])
    with pytest.raises(InfeasibleFitError, match="infeasible"):
        constrained_least_squares(
            np.eye(1), np.ones(1), constraint, np.array([1.0, -np.inf]), np.array([np.inf, 0.0])
        )


def test_a_triangle_gathered_in_chunks_holds_the_norm_of_every_combination(rng):
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
def test_gathered_rows_keep_their_values_unless_they_may_be_spent(rng, order):
    rows = np.asarray(rng.normal(size=(50, 3)), order=order)
    original = rows.copy()
    triangle = gather(empty_triangle(3), rows)
    np.testing.assert_array_equal(rows, original)
    np.testing.assert_array_equal(gather(empty_triangle(3), rows, spend=True), triangle)
