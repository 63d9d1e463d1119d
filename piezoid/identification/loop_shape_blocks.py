"""Cross-validation of a regression for loop shape on left-out blocks.

The errors decide whether loop shape is used, how strongly it is regularised, and whether a step of
the zero is included. The blocks of a single loop differ too much to predict each other: then the
error in sample decides alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from operator import add

import numpy as np

from piezoid.identification.loop_shape_columns import PieceRows
from piezoid.identification.loop_shape_regression import Estimate, Regression
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import FOLDS
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import FamilyRidge, Moments

STEP_INSTANTS = 60  # of a piece, at which a step of the zero is tried
FULL_SPAN = 0.99  # of the range of a drive: above the noise of a measured drive
# Divisors of the prior variances in the last solve. Residuals of a class that is slightly wrong
# are correlated, and stronger regularisation predicts better: of the divisors whose error on
# left-out blocks is close to the minimum, the largest is selected. Fitted to the sweep of the
# bundled axis y alone, it predicts the other drive to 0.14 % of the range, the divisor of minimum
# error to 0.25 %, plays to 0.12 % (before the columns contained the initial states). Initial
# states keep their variance: they matter where no block is left out, and with a divisor of 30 a
# stage had a residual of 18 times the noise there.
VARIANCE_DIVISORS = tuple(10.0 ** (k / 2) for k in range(11))
SIMILAR = 1.03  # error over the minimum
# Error in sample over that of divisor 1. Without this limit the model of one sweep of a Preisach
# stage left 1.8 times the noise in sample, to predict left-out blocks a few percent better.
MAX_IN_SAMPLE = 1.15
# Error over the minimum, above which no larger divisor is tried. On stages of six laws and the
# bundled ones the divisor is that of all eleven trials.
TOO_LARGE = 1.5
UNPENALISED = ("zero", "number", "step")


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of a fit, rms, in half ranges of the displacement unless stated.

    explained  in sample, corrected for the number of parameters of loop shape
    held_out   on left-out blocks; for a single loop equal to ``explained``
    """

    explained: float
    held_out: float


def errors_without_shape(axis: AxisModel, regression: Regression) -> Errors:
    """Return the errors of the plays with dead zones alone.

    The plays were fitted to all blocks. Their held-out error is estimated by the ratio of held-out
    to in-sample error of their own fit: on the bundled axis y 16.4 nm become 17.5 nm, with loop
    shape 16.6 nm. Loop shape uses the same plays, so that even on a stage of plays it has the
    smaller held-out error; only the error in sample then shows that it adds nothing.
    """
    is_zero = np.isin(regression.family, ("zero", "step"))
    zeros = replace(
        regression,
        design=regression.design[:, is_zero],
        family=tuple(np.array(regression.family)[is_zero].tolist()),
        change=np.eye(int(is_zero.sum())),
        value=regression.value[:0],
        lower=regression.lower[:0],
        upper=regression.upper[:0],
        step=regression.step[:0],
        prior=None,
    )
    folds = zeros.moments
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
    held_out = optimism * _held_out_error(zeros, folds, total, ridge)
    return Errors(explained=explained, held_out=held_out)


def errors_of(estimate: Estimate, regression: Regression) -> tuple[Errors, float]:
    """Return the errors with loop shape, and the selected divisor of the prior variances.

    If the class is misspecified, smaller variances than those of maximum marginal likelihood
    predict better.
    """
    folds = regression.moments
    total = total_of(folds)
    coefficient = regression.change @ ridge_of(estimate, regression, total).mean(total)
    residual = (regression.target - regression.design @ coefficient)[regression.use]
    free = max(len(residual) - estimate.parameters, 1.0)
    explained = float(np.sqrt(np.sum(residual**2) / free))
    if not estimate.model.quality.is_tested:
        return Errors(explained=explained, held_out=explained), 1.0
    errors: dict[float, float] = {}
    max_in_sample = MAX_IN_SAMPLE * float(np.sqrt(np.mean(residual**2)))
    for divisor in VARIANCE_DIVISORS:
        ridge = ridge_of(with_smaller_variance(estimate, divisor), regression, total)
        if divisor > 1.0 and _in_sample_error(ridge.mean(total), total) > max_in_sample:
            break
        errors[divisor] = _held_out_error(regression, folds, total, ridge)
        if errors[divisor] > TOO_LARGE * min(errors.values()):
            break
    limit = SIMILAR * min(errors.values())
    divisor = max(divisor for divisor, error in errors.items() if error <= limit)
    return Errors(explained=explained, held_out=errors[divisor]), divisor


def _in_sample_error(coefficient: Array, total: Moments) -> float:
    explained = coefficient @ total.gram @ coefficient - 2.0 * coefficient @ total.moment
    return float(np.sqrt(max(total.square + float(explained), 0.0) / total.count))


def with_smaller_variance(estimate: Estimate, divisor: float) -> Estimate:
    """Return the estimate with the prior variances of the class divided by a number."""
    variance = {
        name: value if name == "initial state" else value / divisor
        for name, value in estimate.variance.items()
    }
    return replace(estimate, variance=variance)


def _held_out_error(
    regression: Regression, folds: Sequence[Moments], total: Moments, ridge: FamilyRidge
) -> float:
    """Return the rms error on left-out blocks.

    The other blocks do not determine a knot of the zero that lies inside a left-out block.
    Therefore equality of neighbouring knots enters with the weight of one row.
    """
    squares, count, smoothing = 0.0, 0, np.zeros_like(total.gram)
    for knots in np.split(regression.members("zero"), np.cumsum(regression.knots)[:-1]):
        difference = np.diff(np.eye(len(knots)), axis=0)
        smoothing[np.ix_(knots, knots)] = difference.T @ difference
    for left_out in folds[:FOLDS]:
        if left_out.count:
            training = total - left_out
            training = replace(training, gram=training.gram + smoothing)
            w = ridge.mean(training)
            explained = w @ left_out.gram @ w - 2.0 * w @ left_out.moment
            squares += left_out.square + float(explained)
            count += left_out.count
    return float(np.sqrt(squares / max(count, 1)))


def with_best_step(
    estimate: Estimate, pieces: Sequence[PieceRows], regression: Regression
) -> Regression | None:
    """Return the regression with the step of the zero that reduces its error most.

    Without a step, a wide class would represent a jump of the zero by hysteresis that does not
    exist. The reduction by a step H, with all coefficients solved again, is
    (r'H)^2 / H'(I - X P^-1 X') H, with r the residual and P the posterior precision.

    No step is tried before the drive has covered its range and travelled as far once more: until
    then a step represents an initial state. On two stages it was at the first maximum of the
    drive, and the model without it had errors of 24 and 36 nm instead of 17.
    """
    total = total_of(regression.moments)
    ridge = ridge_of(estimate, regression, total)
    scale = np.sqrt(np.minimum(ridge.variance, 1e4 * total.square / total.count))[ridge.family]
    inverse = np.linalg.inv(
        total.gram * (scale[:, None] * scale) / ridge.noise + np.eye(len(scale))
    )
    prediction = regression.design @ (regression.change @ ridge.mean(total))
    residual = np.where(estimate.use, regression.target - prediction, 0.0)
    best_step, best_gain = None, 0.0
    for piece, (first, stop) in zip(pieces, pairwise(np.cumsum([0, *estimate.rows])), strict=True):
        drive_V = piece.voltage_V
        span_V = np.maximum.accumulate(drive_V) - np.minimum.accumulate(drive_V)
        travel_V = np.cumsum(np.abs(np.diff(drive_V, prepend=drive_V[0])))
        covered = int(np.searchsorted(span_V, FULL_SPAN * span_V[-1]))
        is_settled = (travel_V >= travel_V[covered] + span_V[-1])[piece.rows]
        instants = np.linspace(first, stop, STEP_INSTANTS + 2)[1:-1].astype(int)
        for row in np.unique(instants[is_settled[instants - first]]):
            step = np.zeros(len(residual))
            step[row:stop] = estimate.use[row:stop]
            h = scale * (regression.change.T @ (step[row:stop] @ regression.design[row:stop]))
            free = float(step @ step - h @ inverse @ h / ridge.noise)
            gain = float(residual @ step) ** 2 / max(free, 1e-9 * float(step @ step) + 1e-300)
            if gain > best_gain:
                best_step, best_gain = step, gain
    return None if best_step is None else with_step_column(regression, best_step)


def with_step_column(regression: Regression, step: Array) -> Regression:
    """Append a step of the zero as last column of a regression."""
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
    """Return the prior of an estimate; families without an estimated variance get initial ones."""
    labels, power = regression.labels, total.square / total.count
    variance = {name: 0.1 * power for name in labels} | {"initial state": 0.3}
    variance |= estimate.variance | dict.fromkeys(UNPENALISED, np.inf)
    return FamilyRidge(
        family=np.array([labels.index(name) for name in regression.family]),
        variance=np.array([variance[name] for name in labels]),
        noise=estimate.noise or 0.01 * power,
    )


def total_of(folds: Sequence[Moments]) -> Moments:
    """Sum the moments of all folds."""
    return reduce(add, folds)
