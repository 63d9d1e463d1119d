"""Nonlinear least squares within bounds: damped steps and one stopping rule.

    min_x  c(x) = |r(x)|^2,   l <= x <= u

    d(mu) = argmin_d  |J d + r|^2 + mu |D d|^2,   l <= x + d <= u,   D_ii = |J_i|

A step that lowers c is taken and mu falls; otherwise mu grows and the same J serves again. A prior
is rows of r like any others. What is linear is eliminated first: ``eliminated``.

Source: Marquardt, SIAM J. 11 (1963), for mu; More, Lecture Notes in Mathematics 630 (1978), for D.
The bounds are part of the step's own problem, solved exactly. What goes wrong: at a kink of c no
step of the linear model may lower it, which ends the search beside a better place.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_minimum, bounded_step, column_norms

LEAST_DAMPING = 1e-9  # keeps normal equations definite where rounding would not
CRAWL = 5  # accepted steps looked at together

Reason = Literal["converged", "crawling", "stationary", "iterations", "evaluations"]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """When a search ends.

    tolerance    relative fall of c in one step that is not worth another
    crawl        relative fall in ``CRAWL`` steps together that is not worth another; 0: ignored
    enough       absolute fall that is not worth another, where c is a log likelihood
    iterations   most linear models
    evaluations  most values of c
    tries        most steps of one linear model
    damping      the first mu
    easier       by how much mu falls where a step lowers c, and
    harder       grows where it does not: less than tenfold where c has many kinks
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
    residual  (rows,)          r, with the same reflections
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
    """The linear model as J'J and J'r, where there are too many rows to reflect at every step.

    They square the condition of J; the damping is what keeps that harmless.

    gram   (numbers, numbers)
    slope  (numbers,)
    cost   |r|^2: what the gradient is scaled by
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
    """Where a search ended.

    x            (numbers,)
    point        there
    reason       converged: the last step lowered c by less than the rule asks; crawling: the last
                 five together did; stationary: none of the tries lowered c; iterations or
                 evaluations: as many as the rule allows
    iterations   linear models made
    evaluations  values of c asked for
    gradient     of the last linear model: largest scaled derivative that no bound holds
    """

    x: Array
    point: AnyPoint
    reason: Reason
    iterations: int
    evaluations: int
    gradient: float

    @property
    def converged(self) -> bool:
        """Return whether the search ended of itself."""
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
                x, point, damping = trial, trial_point, max(damping / rule.easier, LEAST_DAMPING)
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
    """Coefficients that are linear, at their best for given columns: variable projection.

        min_c |A c - y|,   r = P y,   dr = -P dA c,   P = 1 - Q Q',   A = Q K^-1

    Source: Golub & Pereyra, Inverse Problems 19 (2003); dr in Kaufman's form, which leaves out a
    part that vanishes with r.

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
        """Return P t, and how c moves, for tangents t = dA c at fixed c.

        tangent   (rows, numbers)
        returned  (rows, numbers) and (columns, numbers)
        """
        inside = self.Q.T @ tangent
        return tangent - self.Q @ inside, -self.root @ inside


def eliminated(columns: Array, target: Array) -> Eliminated:
    """Solve for the coefficients of columns, scaled to norm 1 first.

    columns  (rows, columns)
    target   (rows,)

    Raises ``numpy.linalg.LinAlgError`` for columns that are dependent to rounding.
    """
    size = column_norms(columns)
    Q, R = np.linalg.qr(columns / size)
    pivot = np.abs(np.diag(R))
    if len(R) < R.shape[1] or not pivot.min(initial=np.inf) > 1e-13 * pivot.max(initial=0.0):
        raise np.linalg.LinAlgError(f"smallest pivot {pivot.min():.1e} of {pivot.max():.1e}")
    root, inside = np.linalg.inv(R) / size[:, None], Q.T @ target
    return Eliminated(Q=Q, root=root, coefficients=root @ inside, residual=target - Q @ inside)
