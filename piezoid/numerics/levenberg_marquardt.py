"""Nonlinear least squares within bounds: damped steps and one stopping rule.

    min_x  c(x) = |r(x)|^2,   l <= x <= u

    d(mu) = argmin_d  |J d + r|^2 + mu |D d|^2,   l <= x + d <= u,   D_ii = |J_i|

A step that lowers c is accepted and mu decreases; otherwise mu increases and J is used again.
Priors are additional rows of r. ``eliminate`` eliminates linear parameters beforehand.

Source: Marquardt, SIAM J. 11 (1963), for mu; More, Lecture Notes in Mathematics 630 (1978), for D.
The bounds are constraints of the problem of the step, which is solved exactly. Limit: at a kink of
c no step of the linear model may lower it, and the search ends although a lower c is near.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_minimum, bounded_step, column_norms

MIN_DAMPING = 1e-9  # keeps normal equations definite in spite of rounding
CRAWL = 5  # accepted steps that are tested together

Reason = Literal["converged", "crawling", "stationary", "iterations", "evaluations"]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """Stopping rule and damping of a search.

    tolerance    relative decrease of c in one step below which the search ends
    crawl        relative decrease in ``CRAWL`` steps together below which it ends; 0: ignored
    enough       absolute decrease below which it ends, for a c that is a log likelihood
    iterations   largest number of linear models
    evaluations  largest number of values of c
    tries        largest number of steps of one linear model
    damping      the first mu
    easier       factor by which mu decreases if a step lowers c
    harder       factor by which mu increases otherwise; less than 10 for a c with many kinks
    """

    tolerance: float = 1e-5
    crawl: float = 0.0
    enough: float = 0.0
    iterations: int = 30
    evaluations: int = 1000
    tries: int = 12
    damping: float = 1e-3
    easier: float = 10.0
    harder: float = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Linear model |J d + r|^2 as rows, or as their triangular factor.

    factor    (rows, columns)  J, or its triangular factor
    residual  (rows,)          r, or Q' r with the triangular factor
    numbers   (columns,)       indices of the parameters of the columns; None: in order
    """

    factor: Array
    residual: Array
    numbers: NDArray[np.intp] | None = None

    def step(self, lower: Array, upper: Array, damping: float) -> Array:
        """Return the damped step, (numbers,), between bounds of the step."""
        numbers = np.arange(len(lower)) if self.numbers is None else self.numbers
        step = np.zeros_like(lower)
        step[numbers] = bounded_step(
            np.vstack([self.factor, np.sqrt(damping) * np.diag(column_norms(self.factor))]),
            np.concatenate([-self.residual, np.zeros(len(numbers))]),
            lower[numbers],
            upper[numbers],
        )
        return step

    def gradient(self, lower: Array, upper: Array) -> float:
        """Return the largest derivative not blocked by a bound, columns and r scaled to norm 1."""
        slope = self.factor.T @ self.residual / column_norms(self.factor)
        if self.numbers is not None:
            lower, upper = lower[self.numbers], upper[self.numbers]
        size = max(float(np.linalg.norm(self.residual)), 1e-300)
        return _steepest(slope, lower, upper) / size


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalEquations:
    """Linear model as J'J and J'r, for problems with too many rows to factor J at every step.

    They square the condition number of J, which is harmless because of the damping.

    gram   (numbers, numbers)  J'J
    slope  (numbers,)          J'r
    cost   |r|^2, which scales the gradient
    """

    gram: Array
    slope: Array
    cost: float

    def step(self, lower: Array, upper: Array, damping: float) -> Array:
        """Return the damped step, (numbers,), between bounds of the step."""
        scale = self._scale()
        scaled = self.gram / np.outer(scale, scale) + damping * np.eye(len(scale))
        step = bounded_minimum(scaled, -self.slope / scale, lower * scale, upper * scale)
        return np.asarray(step / scale)

    def gradient(self, lower: Array, upper: Array) -> float:
        """Return the largest derivative not blocked by a bound, columns and r scaled to norm 1."""
        size = max(float(np.sqrt(self.cost)), 1e-300)
        return _steepest(self.slope / self._scale(), lower, upper) / size

    def _scale(self) -> Array:
        scale = np.sqrt(np.maximum(np.diag(self.gram), 0.0))
        scale[scale == 0.0] = 1.0
        return np.asarray(scale)


def _steepest(slope: Array, lower: Array, upper: Array) -> float:
    is_blocked = ((lower >= 0.0) & (slope > 0.0)) | ((upper <= 0.0) & (slope < 0.0))
    return float(np.abs(np.where(is_blocked, 0.0, slope)).max(initial=0.0))


class Point(Protocol):
    """One evaluated point of the search."""

    @property
    def cost(self) -> float:
        """Return |r|^2 including priors; points with a cost that is not finite are rejected."""

    def linearised(self) -> Rows | NormalEquations:
        """Return the linear model at the point; computed only if the search continues."""


AnyPoint = TypeVar("AnyPoint", bound=Point)


@dataclass(frozen=True, kw_only=True, eq=False)
class Minimum(Generic[AnyPoint]):
    """Result of a search.

    x            (numbers,)
    point        evaluated at x
    reason       converged: the last step lowered c by less than the rule requires; crawling: so
                 did the last five together; stationary: no step of the last model lowered c;
                 iterations or evaluations: the limit was reached
    iterations   number of linear models
    evaluations  number of values of c
    gradient     largest scaled derivative of the last linear model that no bound blocks
    """

    x: Array
    point: AnyPoint
    reason: Reason
    iterations: int
    evaluations: int
    gradient: float

    @property
    def converged(self) -> bool:
        """Return whether the search ended before its limits."""
        return self.reason not in {"iterations", "evaluations"}


def minimise(
    at: Callable[[Array], AnyPoint],
    start: Array,
    bounds: tuple[Array, Array],
    *,
    rule: Rule = Rule(),
    longest: Array | float = np.inf,
    within: Callable[[Array], Array] = lambda x: x,
) -> Minimum[AnyPoint]:
    """Minimise a sum of squares within bounds from a start by Levenberg-Marquardt steps.

    at       x -> point; called once for each trial x
    start    (numbers,)  clipped to the bounds first
    bounds   (numbers,) each; equal bounds fix a number
    longest  (numbers,)  largest step of each number; longer steps are clipped
    within   x -> admissible x, for constraints other than bounds
    """
    lower, upper = bounds
    x = np.clip(start, lower, upper)
    point = at(x)
    costs, damping, iterations, evaluations = [point.cost], rule.damping, 0, 1
    gradient = np.inf
    reason: Reason | None = None
    while reason is None and iterations < rule.iterations:
        model, iterations = point.linearised(), iterations + 1
        gradient = model.gradient(lower - x, upper - x)
        reason = "stationary"
        for _ in range(rule.tries):
            if evaluations >= rule.evaluations:
                reason = "evaluations"
                break
            step = np.clip(model.step(lower - x, upper - x, damping), -longest, longest)
            trial = within(np.clip(x + step, lower, upper))
            trial_point, evaluations = at(trial), evaluations + 1
            if trial_point.cost < point.cost:
                x, point, damping = trial, trial_point, max(damping / rule.easier, MIN_DAMPING)
                costs.append(point.cost)
                reason = None
                if costs[-2] - costs[-1] < max(rule.tolerance * costs[-2], rule.enough):
                    reason = "converged"
                elif len(costs) > CRAWL and 1.0 - costs[-1] / costs[-1 - CRAWL] < rule.crawl:
                    reason = "crawling"
                break
            damping *= rule.harder
    return Minimum(
        x=x,
        point=point,
        reason=reason or "iterations",
        iterations=iterations,
        evaluations=evaluations,
        gradient=gradient,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Eliminated:
    """Linear coefficients that minimise the residual for given columns: variable projection.

        min_c |A c - y|,   r = P y,   dr = -P dA c,   P = 1 - Q Q',   A = Q K^-1

    Source: Golub & Pereyra, Inverse Problems 19 (2003); dr in Kaufman's form, which neglects a
    term that vanishes with r.

    Q             (rows, columns)  orthonormal
    root          (columns, columns)  K: K K' is (A'A)^-1
    coefficients  (columns,)  c
    residual      (rows,)     y - A c
    """

    Q: Array
    root: Array
    coefficients: Array
    residual: Array

    def across(self, tangent: Array) -> tuple[Array, Array]:
        """Return P t and the change of c for tangents t = dA c at fixed c.

        tangent   (rows, numbers)
        returned  (rows, numbers) and (columns, numbers)
        """
        inside = self.Q.T @ tangent
        return tangent - self.Q @ inside, -self.root @ inside


def eliminate(columns: Array, target: Array) -> Eliminated:
    """Solve a linear least-squares problem for the coefficients of columns.

    columns  (rows, columns)
    target   (rows,)

    Raises ``numpy.linalg.LinAlgError`` for columns that are linearly dependent to rounding.
    """
    size = column_norms(columns)
    Q, R = np.linalg.qr(columns / size)
    pivot = np.abs(np.diag(R))
    if len(R) < R.shape[1] or not pivot.min(initial=np.inf) > 1e-13 * pivot.max(initial=0.0):
        raise np.linalg.LinAlgError(f"smallest pivot {pivot.min():.1e} of {pivot.max():.1e}")
    root, inside = np.linalg.inv(R) / size[:, None], Q.T @ target
    return Eliminated(Q=Q, root=root, coefficients=root @ inside, residual=target - Q @ inside)
