"""Least squares: published minima, bounds, and the rule that ends a search.

The NIST problems, starts and certified values are from the Statistical Reference Datasets of the
National Institute of Standards and Technology, nonlinear regression.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import (
    CRAWL,
    Minimum,
    NormalEquations,
    Rows,
    Rule,
    eliminate,
    minimise,
)
from piezoid.numerics.quadratic_program import empty_triangle, gather

Residual = Callable[[Array], Array]
EXACT = Rule(tolerance=1e-14, iterations=500, evaluations=5000)
FREE = np.array(-np.inf), np.array(np.inf)


@dataclass(frozen=True, eq=False)
class Curve:
    """Residual and its derivative by central differences, in one of three forms."""

    residual: Residual
    x: Array
    form: str = "rows"

    @property
    def cost(self) -> float:
        return float(np.sum(self.residual(self.x) ** 2))

    def linearised(self) -> Rows | NormalEquations:
        J, r = slopes(self.residual, self.x), self.residual(self.x)
        if self.form == "normal":
            return NormalEquations(gram=J.T @ J, slope=J.T @ r, cost=self.cost)
        if self.form == "rows":
            return Rows(factor=J, residual=r)
        triangle = empty_triangle(len(self.x) + 1)
        for chunk in np.array_split(np.column_stack([J, r]), 3):
            triangle = gather(triangle, chunk)
        return Rows(factor=triangle[:, :-1], residual=triangle[:, -1])


def slopes(function: Residual, x: Array) -> Array:
    columns = []
    for index in range(len(x)):
        step = np.zeros(len(x))
        step[index] = 1e-5 * max(abs(float(x[index])), 1e-6)
        columns.append((function(x + step) - function(x - step)) / (2.0 * step[index]))
    return np.stack(columns, axis=1)


def search(
    residual: Residual,
    start: Sequence[float],
    *,
    bounds: tuple[Array, Array] = FREE,
    rule: Rule = EXACT,
    form: str = "rows",
) -> Minimum[Curve]:
    start_x = np.array(start, dtype=float)
    lower, upper = (np.broadcast_to(bound, start_x.shape).copy() for bound in bounds)
    return minimise(lambda x: Curve(residual, x, form), start_x, (lower, upper), rule=rule)


@dataclass(frozen=True, kw_only=True)
class Published:
    """Problem of the reference data sets: model, data, both starts, certified numbers."""

    name: str
    model: Callable[[Array, Array], Array]
    x: Sequence[float]
    y: Sequence[float]
    starts: Sequence[Sequence[float]]
    certified: Sequence[float]
    cost: float

    def residual(self, b: Array) -> Array:
        residual: Array = self.model(b, np.array(self.x)) - np.array(self.y)
        return residual


# fmt: off
PUBLISHED = (
    Published(
        name="Misra1a", model=lambda b, x: b[0] * (1.0 - np.exp(-b[1] * x)),
        x=(77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1,
           689.1, 760.0),
        y=(10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40,
           75.47, 81.78),
        starts=((500.0, 1e-4), (250.0, 5e-4)),
        certified=(2.3894212918e2, 5.5015643181e-4), cost=1.2455138894e-1,
    ),
    Published(
        name="MGH09", model=lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
        x=(4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625),
        y=(0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246),
        starts=((25.0, 39.0, 41.5, 39.0), (0.25, 0.39, 0.415, 0.39)),
        certified=(1.9280693458e-1, 1.9128232873e-1, 1.2305650693e-1, 1.3606233068e-1),
        cost=3.0750560385e-4,
    ),
)
# fmt: on
CASES = [(problem, start) for problem in PUBLISHED for start in problem.starts]


@pytest.mark.parametrize("form", ["rows", "triangle", "normal"])
@pytest.mark.parametrize(("problem", "start"), CASES, ids=lambda case: getattr(case, "name", ""))
def test_certified_minima_are_found_from_their_starts(problem, start, form):
    minimum = search(problem.residual, start, form=form)
    assert minimum.converged
    assert minimum.point.cost == pytest.approx(problem.cost, rel=1e-8)
    np.testing.assert_allclose(minimum.x, problem.certified, rtol=1e-4)
    assert minimum.gradient < 1e-3


def test_a_minimum_on_a_bound_is_exactly_on_it():
    """Problem 2 of Hock & Schittkowski (1981): Rosenbrock's valley with x2 >= 1.5."""
    minimum = search(
        lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        (2.0, 3.0),
        bounds=(np.array([-np.inf, 1.5]), np.array(np.inf)),
    )
    assert minimum.point.cost == pytest.approx(0.0504261879, rel=1e-8)
    a = np.sqrt(598.0 / 1200.0)
    best = 2.0 * a * np.cos(np.arccos(1.0 / (400.0 * a**3)) / 3.0)
    np.testing.assert_allclose(minimum.x, [best, 1.5], rtol=1e-6)
    assert minimum.x[1] == 1.5
    assert minimum.gradient < 1e-6  # the bound blocks the remaining gradient


def test_equal_bounds_fix_a_parameter_and_the_start_is_clipped():
    bounds = np.array([200.0, 1e-3]), np.array([200.0, 1.0])
    minimum = search(PUBLISHED[0].residual, (1.0, 1e-9), bounds=bounds)
    np.testing.assert_array_equal(minimum.x, [200.0, 1e-3])
    assert minimum.gradient == 0.0  # the remaining gradient points out of the bounds
    clipped = search(
        lambda x: x - 9.0, (-7.0,), bounds=(np.zeros(1), np.ones(1)), rule=Rule(iterations=0)
    )
    np.testing.assert_array_equal(clipped.x, [0.0])
    highest = search(lambda x: x - 9.0, (0.5,), bounds=(np.zeros(1), np.ones(1)))
    assert (float(highest.x[0]), highest.gradient) == (1.0, 0.0)


def test_eliminated_coefficients_are_least_squares_with_their_derivatives(rng):
    columns, target = rng.normal(size=(30, 3)) * [1e-3, 1.0, 1e3], rng.normal(size=30)
    elimination = eliminate(columns, target)
    np.testing.assert_allclose(
        elimination.coefficients, np.linalg.lstsq(columns, target)[0], rtol=1e-9
    )
    np.testing.assert_allclose(
        elimination.residual, target - columns @ elimination.coefficients, atol=1e-12
    )
    np.testing.assert_allclose(
        elimination.root @ elimination.root.T, np.linalg.inv(columns.T @ columns), rtol=1e-8
    )
    tangent = rng.normal(size=(30, 2))
    across, moves = elimination.across(tangent)
    np.testing.assert_allclose(columns.T @ across, 0.0, atol=1e-7)
    np.testing.assert_allclose(across, tangent + columns @ moves, atol=1e-12)
    with pytest.raises(np.linalg.LinAlgError, match="smallest pivot"):
        eliminate(columns[:, [0, 1, 0]], target)


def test_a_parameter_without_a_column_keeps_its_value():
    @dataclass(frozen=True, eq=False)
    class PartialModel:
        x: Array

        @property
        def cost(self) -> float:
            return float((self.x[2] - 3.0) ** 2 + (self.x[0] - 1.0) ** 2)

        def linearised(self) -> Rows:
            residual = np.array([self.x[2] - 3.0, self.x[0] - 1.0])
            return Rows(factor=np.eye(2), residual=residual, numbers=np.array([2, 0]))

    minimum = minimise(
        PartialModel, np.full(3, 0.25), (np.full(3, -9.0), np.full(3, 9.0)), rule=EXACT
    )
    np.testing.assert_allclose(minimum.x, [1.0, 0.25, 3.0], atol=1e-6)


def test_every_trial_keeps_the_longest_move_and_the_allowed_range():
    points = []

    def evaluate(x: Array) -> Curve:
        points.append(x)
        return Curve(lambda x: x - 7.0, x)

    no_bounds = np.full(2, -np.inf), np.full(2, np.inf)
    longest = np.array([0.5, np.inf])

    def clip(x: Array) -> Array:
        return np.minimum(x, [np.inf, 3.0])

    minimum = minimise(evaluate, np.zeros(2), no_bounds, rule=EXACT, longest=longest, within=clip)
    np.testing.assert_allclose(minimum.x, [7.0, 3.0], atol=1e-6)
    moves = np.abs(np.diff([x[0] for x in points]))
    assert moves.max() <= 0.5 * (1.0 + 1e-12)
    assert max(x[1] for x in points) == 3.0


@dataclass(frozen=True, eq=False)
class Staircase:
    """Point whose cost is the next of a list, whatever the step."""

    costs: Iterator[float]
    cost: float

    def linearised(self) -> Rows:
        return Rows(factor=np.eye(1), residual=np.ones(1))


def descend(*shares: float, rule: Rule) -> Minimum[Staircase]:
    """Search where each step lowers the cost by the next share; the last share repeats."""

    def costs() -> Iterator[float]:
        cost = 1.0
        yield cost
        for share in shares:
            cost *= 1.0 - share
            yield cost
        while True:
            cost *= 1.0 - shares[-1]
            yield cost

    values = costs()
    bounds = np.full(1, -np.inf), np.full(1, np.inf)
    return minimise(lambda _: Staircase(values, next(values)), np.zeros(1), bounds, rule=rule)


RULE = Rule(tolerance=1e-5, crawl=1e-3)


@pytest.mark.parametrize(
    ("shares", "rule", "reason", "iterations"),
    [
        ((0.5, 0.5, 1e-6), RULE, "converged", 3),
        # In units of the cost, as for a log likelihood: 0.5, 0.25, 0.025.
        ((0.5, 0.5, 0.1), Rule(tolerance=0.0, enough=0.03), "converged", 3),
        ((0.5, 0.1, 1.5e-4), RULE, "crawling", 2 + CRAWL),
        ((1.5e-4,), RULE, "crawling", CRAWL),
        # A few small steps do not end a search that then improves again.
        ((0.5, 1e-4, 1e-4, 1e-4, 1e-4, 0.3, 1e-6), RULE, "converged", 7),
        ((0.5, 1e-3), replace(RULE, iterations=20), "iterations", 20),
        ((0.5, 1e-3), replace(RULE, evaluations=7), "evaluations", 7),
    ],
)
def test_a_search_ends_by_its_rule_and_states_the_reason(shares, rule, reason, iterations):
    minimum = descend(*shares, rule=rule)
    count = minimum.evaluations if reason == "evaluations" else minimum.iterations
    assert (minimum.reason, count) == (reason, iterations)
    assert minimum.converged is (reason in ("converged", "crawling"))


@pytest.mark.parametrize("share", [0.0, -0.5, np.nan])
def test_a_search_without_improvement_is_stationary(share):
    minimum = descend(share, rule=RULE)
    assert minimum.converged
    assert (minimum.reason, minimum.iterations, minimum.point.cost) == ("stationary", 1, 1.0)
    assert minimum.evaluations == 1 + RULE.tries
    np.testing.assert_array_equal(minimum.x, [0.0])


def linear_models(J: Array, r: Array) -> tuple[Rows, NormalEquations]:
    return Rows(factor=J, residual=r), NormalEquations(gram=J.T @ J, slope=J.T @ r, cost=r @ r)


def test_a_damped_step_is_the_least_squares_of_its_rows(rng):
    """Columns of any size have the same damping; a column of zeros has no step."""
    J, r = rng.normal(size=(9, 4)) * [1e-3, 1.0, 1e3, 0.0], rng.normal(size=9)
    unbounded = np.full(4, np.inf)
    for damping in (1e-6, 0.3):
        damped = np.vstack([J, np.sqrt(damping) * np.diag(np.linalg.norm(J, axis=0))])[:, :3]
        free = np.linalg.lstsq(damped, np.concatenate([-r, np.zeros(4)]))[0]
        for model in linear_models(J, r):
            np.testing.assert_allclose(
                model.step(-unbounded, unbounded, damping), [*free, 0.0], rtol=1e-5
            )


def test_nearly_dependent_columns_are_solved(rng):
    columns = rng.normal(size=(30, 2))
    columns = np.column_stack([columns, columns[:, 0] + 1e-10 * rng.normal(size=30)])
    target = columns @ np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(eliminate(columns, target).residual, 0.0, atol=1e-12)


def test_the_gradient_is_the_largest_cosine_that_no_bound_blocks(rng):
    J, r = rng.normal(size=(9, 3)) * [1e-3, 1.0, 1e3], rng.normal(size=9)
    cosine = J.T @ r / np.linalg.norm(J, axis=0) / np.linalg.norm(r)
    order = np.argsort(-np.abs(cosine))
    unbounded = np.full(3, np.inf)
    for model in linear_models(J, r):
        assert model.gradient(-unbounded, unbounded) == pytest.approx(np.abs(cosine).max())
        lower, upper = -unbounded, unbounded.copy()
        for index, steepest in zip(order, [*np.abs(cosine[order[1:]]), 0.0], strict=True):
            # Only a bound in the direction of falling cost blocks a parameter.
            blocking, opposite = (lower, upper) if cosine[index] > 0.0 else (upper, lower)
            opposite[index] = 0.0
            assert model.gradient(lower, upper) == pytest.approx(abs(cosine[index]))
            opposite[index] = -np.inf if opposite is lower else np.inf
            blocking[index] = 0.0
            assert model.gradient(lower, upper) == pytest.approx(steepest)
