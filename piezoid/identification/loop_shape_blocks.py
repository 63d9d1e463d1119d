"""Errors of a regression for loop shape on blocks that its solve left out.

They decide whether loop shape ships, with how much freedom, and beside which step of the zero. Of
a single loop no block is like those that remain: there the error in sample decides alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from operator import add

import numpy as np

from piezoid.identification.loop_shape_columns import FOLDS
from piezoid.identification.loop_shape_estimate import Estimate
from piezoid.identification.loop_shape_regression import Regression
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import FamilyRidge, Moments

STEP_PLACES = 60  # of a piece, at which a step of the zero is tried
# Divisors of the prior variances in the last solve. Residuals of a class that is slightly wrong
# are correlated, and less freedom predicts better: of the divisors whose error on left-out blocks
# is close to the least, the largest is taken. Fitted to the sweep of the bundled axis y alone, it
# predicts the other drive to 0.14 % of the range, the best one to 0.25 %, plays to 0.12 % (before
# the columns contained the initial states). Initial states keep their variance: they show where
# no block is left out, and with a divisor of 30 a stage left 18 times the noise there.
FREEDOM_FACTORS = tuple(10.0 ** (k / 2) for k in range(11))
CLOSE = 1.03
UNPENALISED = ("zero", "number", "step")


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors in units of half the stroke.

    explained  in sample, corrected for the number of parameters of loop shape
    held_out   on left-out blocks; of a single loop as explained
    """

    explained: float
    held_out: float


def plain_errors(axis: AxisModel, regression: Regression) -> Errors:
    """Return the errors of the plays with dead zones.

    The plays were fitted to all blocks. What leaving blocks out adds to their error is known from
    their own fit: on the bundled axis y 16.4 nm become 17.5, and loop shape leaves 16.6. It stands
    on the same plays, so that on a stage of plays its error of left-out blocks is below theirs as
    well; only the error in sample shows that it adds nothing.
    """
    free = np.isin(regression.family, ("zero", "step"))
    zeros = replace(
        regression,
        design=regression.design[:, free],
        family=tuple(np.array(regression.family)[free].tolist()),
        change=np.eye(int(free.sum())),
        value=regression.value[:0],
        lower=regression.lower[:0],
        upper=regression.upper[:0],
        step=regression.step[:0],
        prior=None,
    )
    folds = zeros.moments()
    total = total_of(folds)
    labels = zeros.labels
    ridge = FamilyRidge(
        family=np.array([labels.index(name) for name in zeros.family]),
        variance=np.full(len(labels), np.inf),
        noise=1e-6 * total.square / total.count,
    )
    error = zeros.target - zeros.design @ ridge.mean(total)
    explained = float(np.sqrt(np.mean(error[zeros.use] ** 2)))
    quality = axis.quality
    if not quality.is_tested:
        return Errors(explained=explained, held_out=explained)
    optimism = max(quality.held_out_rms_m / quality.rms_m, 1.0)
    return Errors(explained=explained, held_out=optimism * _error(zeros, folds, total, ridge))


def errors_of(estimate: Estimate, regression: Regression) -> tuple[Errors, float]:
    """Return the errors with loop shape, and the factor of the prior variances.

    Where the class is wrong, less freedom predicts better than marginal likelihood says.
    """
    folds = regression.moments()
    total = total_of(folds)
    coefficient = regression.change @ ridge_of(estimate, regression, total).mean(total)
    residual = (regression.target - regression.design @ coefficient)[regression.use]
    free = max(len(residual) - estimate.parameters, 1.0)
    explained = float(np.sqrt(np.sum(residual**2) / free))
    if not estimate.model.quality.is_tested:
        return Errors(explained=explained, held_out=explained), 1.0
    tried = {}
    for factor in FREEDOM_FACTORS:
        ridge = ridge_of(with_less_freedom(estimate, factor), regression, total)
        tried[factor] = _error(regression, folds, total, ridge)
    close = CLOSE * min(tried.values())
    factor = max(factor for factor, error in tried.items() if error <= close)
    return Errors(explained=explained, held_out=tried[factor]), factor


def with_less_freedom(estimate: Estimate, factor: float) -> Estimate:
    """Return the estimate with the prior variances of the class divided by a factor."""
    variance = {
        name: value if name == "initial state" else value / factor
        for name, value in estimate.variance.items()
    }
    return replace(estimate, variance=variance)


def _error(
    regression: Regression, folds: Sequence[Moments], total: Moments, ridge: FamilyRidge
) -> float:
    """Return the error on left-out blocks, rms.

    A knot of a zero that lies in one block is not determined by the others: it counts as one
    reading that neighbouring knots are equal.
    """
    squares, count, tied = 0.0, 0, np.zeros_like(total.gram)
    for knots in np.split(regression.places("zero"), np.cumsum(regression.knots)[:-1]):
        difference = np.diff(np.eye(len(knots)), axis=0)
        tied[np.ix_(knots, knots)] = difference.T @ difference
    for number in range(FOLDS):
        rows = (regression.fold == number) & regression.use
        if rows.any():
            others = total - folds[number]
            fitted = regression.change @ ridge.mean(replace(others, gram=others.gram + tied))
            error = regression.target[rows] - regression.design[rows] @ fitted
            squares, count = squares + float(error @ error), count + len(error)
    return float(np.sqrt(squares / max(count, 1)))


def with_step(estimate: Estimate, regression: Regression) -> Regression | None:
    """Return the regression with a step of the zero where that gains most.

    A wide class follows a jump of the zero by hysteresis that does not exist. The gain of a step H
    beside everything else is (r'H)^2 / H'(I - X P^-1 X') H, with P the posterior precision.
    """
    total = total_of(regression.moments())
    ridge = ridge_of(estimate, regression, total)
    scale = np.sqrt(np.minimum(ridge.variance, 1e4 * total.square / total.count))[ridge.family]
    inverse = np.linalg.inv(
        total.gram * (scale[:, None] * scale) / ridge.noise + np.eye(len(scale))
    )
    solved = regression.design @ (regression.change @ ridge.mean(total))
    residual = np.where(estimate.use, regression.target - solved, 0.0)
    best, gain = None, 0.0
    edges = np.cumsum([0, *estimate.rows])
    for first, last in pairwise(edges):
        places = np.linspace(first, last, STEP_PLACES + 2)[1:-1].astype(int)
        for place in np.unique(places):
            step = np.zeros(len(residual))
            step[place:last] = estimate.use[place:last]
            h = scale * (regression.change.T @ (step[place:last] @ regression.design[place:last]))
            free = float(step @ step - h @ inverse @ h / ridge.noise)
            tried = float(residual @ step) ** 2 / max(free, 1e-9 * float(step @ step) + 1e-300)
            if tried > gain:
                best, gain = step, tried
    return None if best is None else beside_step(regression, best)


def beside_step(regression: Regression, step: Array) -> Regression:
    """Return the regression with a step of the zero as last column."""
    size = len(regression.family)
    change = np.eye(size + 1)
    change[:size, :size] = regression.change
    return replace(
        regression,
        design=np.column_stack([regression.design, step]),
        family=(*regression.family, "step"),
        change=change,
    )


def ridge_of(estimate: Estimate, regression: Regression, total: Moments) -> FamilyRidge:
    """Return the ridge from which the fixed point starts: that of the last round."""
    labels, power = regression.labels, total.square / total.count
    first = {name: 0.1 * power for name in labels} | {"initial state": 0.3}
    first |= estimate.variance | dict.fromkeys(UNPENALISED, np.inf)
    return FamilyRidge(
        family=np.array([labels.index(name) for name in regression.family]),
        variance=np.array([first[name] for name in labels]),
        noise=estimate.noise or 0.01 * power,
    )


def total_of(folds: Sequence[Moments]) -> Moments:
    """Return the moments of all folds together."""
    return reduce(add, folds)
