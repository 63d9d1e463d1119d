"""Least squares with published minima, within bounds, and the rule by which a search ends.

NIST problems: Statistical Reference Datasets of the National Institute of Standards and
Technology, nonlinear regression; starts and certified values as given there.
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
    """A residual and its derivative by central differences, in one of three forms."""

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
    for place in range(len(x)):
        step = np.zeros(len(x))
        step[place] = 1e-5 * max(abs(float(x[place])), 1e-6)
        columns.append((function(x + step) - function(x - step)) / (2.0 * step[place]))
    return np.stack(columns, axis=1)


def searched(
    residual: Residual,
    start: Sequence[float],
    *,
    bounds: tuple[Array, Array] = FREE,
    rule: Rule = EXACT,
    form: str = "rows",
) -> Minimum[Curve]:
    first = np.array(start, dtype=float)
    lower, upper = (np.broadcast_to(bound, first.shape).copy() for bound in bounds)
    return minimise(lambda x: Curve(residual, x, form), first, (lower, upper), rule=rule)


@dataclass(frozen=True, kw_only=True)
class Published:
    """A problem of the reference data sets: model, data, both starts, certified numbers."""

    name: str
    model: Callable[[Array, Array], Array]
    x: Sequence[float]
    y: Sequence[float]
    starts: Sequence[Sequence[float]]
    certified: Sequence[float]
    cost: float

    def residual(self, b: Array) -> Array:
        left: Array = self.model(b, np.array(self.x)) - np.array(self.y)
        return left


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
HARD = [(problem, start) for problem in PUBLISHED for start in problem.starts]


@pytest.mark.parametrize("form", ["rows", "triangle", "normal"])
@pytest.mark.parametrize(("problem", "start"), HARD, ids=lambda case: getattr(case, "name", ""))
def test_certified_minima_are_found_from_their_starts(
    problem: Published, start: Sequence[float], form: str
) -> None:
    found = searched(problem.residual, start, form=form)
    assert found.converged
    assert found.point.cost == pytest.approx(problem.cost, rel=1e-8)
    np.testing.assert_allclose(found.x, problem.certified, rtol=1e-4)
    assert found.gradient < 1e-3


def test_a_bound_that_the_minimum_lies_on_is_met_exactly() -> None:
    """Problem 2 of Hock & Schittkowski (1981): Rosenbrock's valley cut off at x2 >= 1.5."""
    found = searched(
        lambda x: np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]),
        (2.0, 3.0),
        bounds=(np.array([-np.inf, 1.5]), np.array(np.inf)),
    )
    assert found.point.cost == pytest.approx(0.0504261879, rel=1e-8)
    a = np.sqrt(598.0 / 1200.0)
    best = 2.0 * a * np.cos(np.arccos(1.0 / (400.0 * a**3)) / 3.0)
    np.testing.assert_allclose(found.x, [best, 1.5], rtol=1e-6)
    assert found.x[1] == 1.5
    assert found.gradient < 1e-6  # the bound holds what is left


def test_equal_bounds_hold_a_number_and_the_start_is_brought_within_the_others() -> None:
    bounds = np.array([200.0, 1e-3]), np.array([200.0, 1.0])
    found = searched(PUBLISHED[0].residual, (1.0, 1e-9), bounds=bounds)
    np.testing.assert_array_equal(found.x, [200.0, 1e-3])
    assert found.gradient == 0.0  # all that is left points out of the bounds
    asked = searched(
        lambda x: x - 9.0, (-7.0,), bounds=(np.zeros(1), np.ones(1)), rule=Rule(iterations=0)
    )
    np.testing.assert_array_equal(asked.x, [0.0])
    highest = searched(lambda x: x - 9.0, (0.5,), bounds=(np.zeros(1), np.ones(1)))
    assert (float(highest.x[0]), highest.gradient) == (1.0, 0.0)


def test_eliminated_coefficients_are_those_of_least_squares_and_say_how_they_move(
    rng: np.random.Generator,
) -> None:
    columns, target = rng.normal(size=(30, 3)) * [1e-3, 1.0, 1e3], rng.normal(size=30)
    at = eliminate(columns, target)
    np.testing.assert_allclose(at.coefficients, np.linalg.lstsq(columns, target)[0], rtol=1e-9)
    np.testing.assert_allclose(at.residual, target - columns @ at.coefficients, atol=1e-12)
    np.testing.assert_allclose(at.root @ at.root.T, np.linalg.inv(columns.T @ columns), rtol=1e-8)
    tangent = rng.normal(size=(30, 2))
    across, moves = at.across(tangent)
    np.testing.assert_allclose(columns.T @ across, 0.0, atol=1e-7)
    np.testing.assert_allclose(across, tangent + columns @ moves, atol=1e-12)
    with pytest.raises(np.linalg.LinAlgError, match="smallest pivot"):
        eliminate(columns[:, [0, 1, 0]], target)


def test_what_is_in_the_model_for_no_column_stays_where_it_was() -> None:
    @dataclass(frozen=True, eq=False)
    class Partly:
        x: Array

        @property
        def cost(self) -> float:
            return float((self.x[2] - 3.0) ** 2 + (self.x[0] - 1.0) ** 2)

        def linearised(self) -> Rows:
            residual = np.array([self.x[2] - 3.0, self.x[0] - 1.0])
            return Rows(factor=np.eye(2), residual=residual, numbers=np.array([2, 0]))

    found = minimise(Partly, np.full(3, 0.25), (np.full(3, -9.0), np.full(3, 9.0)), rule=EXACT)
    np.testing.assert_allclose(found.x, [1.0, 0.25, 3.0], atol=1e-6)


def test_a_longest_move_and_what_is_allowed_are_kept_at_every_trial() -> None:
    tried = []

    def at(x: Array) -> Curve:
        tried.append(x)
        return Curve(lambda x: x - 7.0, x)

    no_bounds = np.full(2, -np.inf), np.full(2, np.inf)
    longest = np.array([0.5, np.inf])

    def within(x: Array) -> Array:
        return np.minimum(x, [np.inf, 3.0])

    found = minimise(at, np.zeros(2), no_bounds, rule=EXACT, longest=longest, within=within)
    np.testing.assert_allclose(found.x, [7.0, 3.0], atol=1e-6)
    moves = np.abs(np.diff([x[0] for x in tried]))
    assert moves.max() <= 0.5 * (1.0 + 1e-12)
    assert max(x[1] for x in tried) == 3.0


@dataclass(frozen=True, eq=False)
class Staircase:
    """A place whose cost is the next of a list, whatever the step."""

    costs: Iterator[float]
    cost: float

    def linearised(self) -> Rows:
        return Rows(factor=np.eye(1), residual=np.ones(1))


def descended(*shares: float, rule: Rule) -> Minimum[Staircase]:
    """Search where step after step lowers the cost by given shares, the last again and again."""

    def costs() -> Iterator[float]:
        now = 1.0
        yield now
        for share in shares:
            now *= 1.0 - share
            yield now
        while True:
            now *= 1.0 - shares[-1]
            yield now

    down = costs()
    free = np.full(1, -np.inf), np.full(1, np.inf)
    return minimise(lambda _: Staircase(down, next(down)), np.zeros(1), free, rule=rule)


RULE = Rule(tolerance=1e-5, crawl=1e-3)


@pytest.mark.parametrize(
    ("shares", "rule", "reason", "iterations"),
    [
        ((0.5, 0.5, 1e-6), RULE, "converged", 3),
        # In units of the cost itself, as of a log likelihood: 0.5, 0.25, 0.025.
        ((0.5, 0.5, 0.1), Rule(tolerance=0.0, enough=0.03), "converged", 3),
        ((0.5, 0.1, 1.5e-4), RULE, "crawling", 2 + CRAWL),
        ((1.5e-4,), RULE, "crawling", CRAWL),
        # A search that finds its stride again is not ended by a few small steps.
        ((0.5, 1e-4, 1e-4, 1e-4, 1e-4, 0.3, 1e-6), RULE, "converged", 7),
        ((0.5, 1e-3), replace(RULE, iterations=20), "iterations", 20),
        ((0.5, 1e-3), replace(RULE, evaluations=7), "evaluations", 7),
    ],
)
def test_a_search_ends_by_its_rule_and_says_by_which(
    shares: Sequence[float], rule: Rule, reason: str, iterations: int
) -> None:
    found = descended(*shares, rule=rule)
    ended = found.evaluations if reason == "evaluations" else found.iterations
    assert (found.reason, ended) == (reason, iterations)
    assert found.converged is (reason in ("converged", "crawling"))


@pytest.mark.parametrize("worse", [0.0, -0.5, np.nan])
def test_a_search_that_no_step_helps_ends_where_it_stands(worse: float) -> None:
    found = descended(worse, rule=RULE)
    assert found.converged
    assert (found.reason, found.iterations, found.point.cost) == ("stationary", 1, 1.0)
    assert found.evaluations == 1 + RULE.tries
    np.testing.assert_array_equal(found.x, [0.0])


def both_forms(J: Array, r: Array) -> tuple[Rows, NormalEquations]:
    return Rows(factor=J, residual=r), NormalEquations(gram=J.T @ J, slope=J.T @ r, cost=r @ r)


def test_a_damped_step_is_the_least_squares_of_its_rows(rng: np.random.Generator) -> None:
    """Columns of any size are damped alike, one of zeros not at all moved."""
    J, r = rng.normal(size=(9, 4)) * [1e-3, 1.0, 1e3, 0.0], rng.normal(size=9)
    far = np.full(4, np.inf)
    for damping in (1e-6, 0.3):
        damped = np.vstack([J, np.sqrt(damping) * np.diag(np.linalg.norm(J, axis=0))])[:, :3]
        free = np.linalg.lstsq(damped, np.concatenate([-r, np.zeros(4)]))[0]
        for model in both_forms(J, r):
            np.testing.assert_allclose(model.step(-far, far, damping), [*free, 0.0], rtol=1e-5)


def test_columns_that_are_nearly_dependent_are_solved_for(rng: np.random.Generator) -> None:
    columns = rng.normal(size=(30, 2))
    columns = np.column_stack([columns, columns[:, 0] + 1e-10 * rng.normal(size=30)])
    target = columns @ np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(eliminate(columns, target).residual, 0.0, atol=1e-12)


def test_the_gradient_is_the_steepest_cosine_that_no_bound_holds(rng: np.random.Generator) -> None:
    J, r = rng.normal(size=(9, 3)) * [1e-3, 1.0, 1e3], rng.normal(size=9)
    cosine = J.T @ r / np.linalg.norm(J, axis=0) / np.linalg.norm(r)
    order = np.argsort(-np.abs(cosine))
    far = np.full(3, np.inf)
    for model in both_forms(J, r):
        assert model.gradient(-far, far) == pytest.approx(np.abs(cosine).max())
        lower, upper = -far, far.copy()
        for held, steepest in zip(order, [*np.abs(cosine[order[1:]]), 0.0], strict=True):
            # A bound on the side to which the cost falls holds a number, one behind it does not.
            ahead, behind = (lower, upper) if cosine[held] > 0.0 else (upper, lower)
            behind[held] = 0.0
            assert model.gradient(lower, upper) == pytest.approx(abs(cosine[held]))
            behind[held] = -np.inf if behind is lower else np.inf
            ahead[held] = 0.0
            assert model.gradient(lower, upper) == pytest.approx(steepest)
