"""Fit loop shape: the wide class of hysteresis, to the residual of plays with dead zones.

    y - y_plays = F(X w) + b P + sum_k a_k D_k + zero + sum_j t_j dy/dp_j + e

X are the columns of ``operators.wide_hysteresis`` along the drive, F the filters behind the
hysteresis, P the remainder of the plays that the class cannot approximate, D_k the change of the
response by another history of the drive, and t_j the changes of the numbers p_j of lag and
extensions. The zero is interpolated between the knots of the fit of the plays. Ridge regression
with one prior variance for each family of columns gives the coefficients. D_k and the derivatives
depend on the estimate, so that the regression is iterated until the numbers converge, as in
Gauss-Newton with the linear coefficients eliminated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.loop_shape import FitWithoutShape
from piezoid.identification.loop_shape_blocks import (
    Errors,
    errors_of,
    errors_without_shape,
    ridge_of,
    total_of,
    with_best_step,
    with_smaller_variance,
    with_step_column,
)
from piezoid.identification.loop_shape_columns import (
    Columns,
    PieceRows,
    columns_of,
    piece_rows,
    reference_columns,
    zero_loop_shape,
)
from piezoid.identification.loop_shape_regression import (
    Estimate,
    Regression,
    first_estimate,
    half_range_m,
    interpolated,
    regression_of,
    residual_of,
    with_numbers,
    with_sensor_numbers,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import BLOCKS, IN_SAMPLE, FitQuality, with_noise_bound
from piezoid.numerics.arrays import Array
from piezoid.operators.wide_hysteresis import coefficients
from piezoid.records.recording import Recording

MIN_ROWS = 500
MIN_ITERATIONS, MAX_ITERATIONS = 3, 8
# Largest number of solves with the final prior. On the bundled axis y the residual of the first is
# 168 nm, and 11.4 nm with its weights of histories solved again; on seven stages the second was no
# better than that.
FINAL_SOLVES = 5
# Simulated error over that of the linearised solution, up to which no further solve is made. On
# stages of three laws the solves behind it would have reduced the error by 0, 0.3 and 0 %.
ENOUGH = 1.005
MAX_RATIO = 0.97  # of each error to that without loop shape: a smaller gain is not worth the class
MAX_INCREASE = 1.02  # noise variance over the minimum: lag and extensions no longer improve it
MAX_STEP_RATIO = 0.9  # held-out error with a step of the zero over that without
# Explained error with a step over the noise: if there are other errors, a step represents those.
# For a true jump of the zero it was 1.0; for a periodic error with a wrong phase 1.3 and 1.65, and
# the model fitted together with that step, but used without it, had an error of 25 nm, not 18.
MAX_NOISE_RATIO = 1.2
OUTLIER = 7.0  # robust standard deviations
MAX_SHIFT = 0.02  # of the residual: a larger change by lag and extensions needs new columns
SHARES = tuple(0.5**k for k in range(6))  # of the change by a solve
TOLERANCE = 1.1  # of a simulated error over the larger of the present and the predicted error


@dataclass(frozen=True, kw_only=True, eq=False)
class _Comparison:
    """Estimate of loop shape, and its errors beside those without loop shape.

    regression     at the estimate, with a step of the zero if there is one
    divisor        of the prior variances
    errors         with loop shape, in half ranges of the displacement
    errors_before  without loop shape
    """

    estimate: Estimate
    pieces: tuple[PieceRows, ...]
    columns: Columns
    regression: Regression
    divisor: float
    errors: Errors
    errors_before: Errors


def with_loop_shape(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with loop shape if that predicts left-out blocks better.

    recordings  of the fit; a recording that the model does not contain is ignored
    """
    if axis.loop_shape is not None:
        raise ValueError(f"axis {axis.axis} has loop shape already")
    comparison = _compared(axis, recordings)
    if comparison is None:
        return axis
    errors, errors_before = comparison.errors, comparison.errors_before
    if (
        errors.held_out > MAX_RATIO * errors_before.held_out
        or errors.explained > MAX_RATIO * errors_before.explained
    ):
        return axis
    pieces, regression = comparison.pieces, comparison.regression
    start = with_smaller_variance(comparison.estimate, comparison.divisor)
    final = _converged(start, pieces, comparison.columns, regression)
    shape, scale_m = final.model.loop_shape, abs(half_range_m(axis))
    assert shape is not None
    fit_without_shape = FitWithoutShape(
        lag_s=axis.lag.time_s,
        rms_m=scale_m * errors_before.explained,
        held_out_rms_m=scale_m * errors_before.held_out,
        quality=axis.quality,
        starts=axis.starts,
    )
    fitted = {
        id(piece.start): replace(piece.start, zero_m=zero_m, history_weight=weight)
        for piece, zero_m, weight in zip(pieces, final.zeros, final.weights, strict=True)
    }
    return replace(
        final.model,
        loop_shape=replace(shape, plain=fit_without_shape),
        quality=_quality(axis, final, regression, scale_m * errors.held_out),
        starts=tuple(fitted.get(id(start), start) for start in final.model.starts),
    )


def errors_with_loop_shape_m(axis: AxisModel, recordings: Sequence[Recording]) -> Errors:
    """Return the errors of an axis with loop shape, rms in m; infinite with too few rows.

    The fit of the plays may be that of a model with further extensions: loop shape then represents
    the difference.
    """
    comparison = _compared(axis, recordings)
    if comparison is None:
        return Errors(explained=np.inf, held_out=np.inf)
    errors, scale_m = comparison.errors, abs(half_range_m(axis))
    return Errors(explained=scale_m * errors.explained, held_out=scale_m * errors.held_out)


def _compared(axis: AxisModel, recordings: Sequence[Recording]) -> _Comparison | None:
    """Estimate loop shape and compare its errors; None if there are too few rows."""
    pieces = piece_rows(axis, recordings)
    if sum(len(piece.rows) for piece in pieces) < MIN_ROWS:
        return None
    reference = reference_columns(axis)
    columns = columns_of(axis, pieces, reference)
    estimate = first_estimate(axis, pieces, columns)
    regression = regression_of(estimate, pieces, columns)
    errors_before = errors_without_shape(axis, regression)
    best = estimate, pieces, columns
    for iteration in range(MAX_ITERATIONS):
        solution = _solved(estimate, columns, regression)
        damped = _damped(estimate, solution, pieces, columns, regression)
        # The columns hold for the present lag and extensions: the new ones need new columns.
        present = estimate.model
        model = replace(damped.model, lag=present.lag, extensions=present.extensions)
        consistent = with_sensor_numbers(replace(damped, model=model), pieces, columns)
        if iteration < MIN_ITERATIONS - 1 or consistent.noise < best[0].noise:
            best = consistent, pieces, columns
        elif consistent.noise > MAX_INCREASE * best[0].noise:
            break
        if damped.shift > MAX_SHIFT:
            forward = damped.model.forward
            pieces = tuple(
                replace(piece, drive_V=forward.driven_V(piece.voltage_V, piece.where.rate_Hz))
                for piece in pieces
            )
            columns = columns_of(damped.model, pieces, reference)
            estimate = with_sensor_numbers(damped, pieces, columns)
        else:
            estimate = consistent
            if iteration + 1 >= MIN_ITERATIONS and consistent.shift <= MAX_SHIFT:
                break
        regression = regression_of(estimate, pieces, columns)
    estimate, pieces, columns = best
    regression = regression_of(estimate, pieces, columns, has_numbers=False)
    errors, divisor = errors_of(estimate, regression)
    with_step = with_best_step(estimate, pieces, regression)
    if with_step is not None:
        step_errors, step_divisor = errors_of(estimate, with_step)
        noise = axis.quality.noise_rms_m / abs(half_range_m(axis))
        reaches_noise = step_errors.explained < MAX_NOISE_RATIO * noise
        if reaches_noise and step_errors.held_out < MAX_STEP_RATIO * errors.held_out:
            regression, divisor, errors = with_step, step_divisor, step_errors
            errors_before = errors_without_shape(axis, with_step)
    return _Comparison(
        estimate=estimate,
        pieces=pieces,
        columns=columns,
        regression=regression,
        divisor=divisor,
        errors=errors,
        errors_before=errors_before,
    )


def _solved(
    estimate: Estimate, columns: Columns, regression: Regression, steps: int = 40
) -> Estimate:
    """Solve a regression: variances by marginal likelihood, coefficients, lag and outliers.

    steps  of the fixed point of the variances
    """
    axis, scale_m = estimate.model, half_range_m(estimate.model)
    total = total_of(regression.moments)
    ridge = ridge_of(estimate, regression, total)
    # Numbers at a bound that would move beyond it stay there.
    numbers, violates = regression.members("number"), np.zeros(len(regression.family), dtype=bool)
    step = regression.step * (regression.change @ ridge.mean(total))[numbers]
    violates[numbers] = ((regression.value <= regression.lower) & (step < 0.0)) | (
        (regression.value >= regression.upper) & (step > 0.0)
    )
    if violates.any():
        regression = regression.without(violates)
        total = total_of(regression.moments)
    is_history = np.array([name == "initial state" for name in regression.labels])
    ceiling = np.where(is_history, 1.0, np.inf)
    ridge, orthogonal, parameters = ridge.maximised(total, ceiling=ceiling, steps=steps)
    coefficient = regression.change @ orthogonal
    residual = regression.target - regression.design @ coefficient
    wide = coefficient[: len(columns.scale)]
    change_m = regression.design[:, numbers] @ coefficient[numbers]
    if len(numbers):
        values = regression.value + regression.step * coefficient[numbers]
        axis = with_numbers(axis, np.clip(values, regression.lower, regression.upper))
    remainder = float(wide[-1] / columns.scale[-1])  # of the plays, beyond the smooth class
    smooth_class = wide / columns.scale - remainder * columns.plays
    density, smooth = coefficients(smooth_class[:-1])
    shape = replace(
        axis.loop_shape or zero_loop_shape(axis),
        plays_weight=1.0 + remainder,
        density_m=abs(scale_m) * density,
        smooth_m=abs(scale_m) * smooth,
    )
    weights, use = estimate.weights, estimate.use
    if estimate.variance:  # the first regression has no columns of histories
        weights = _split(coefficient[regression.members("initial state")], weights)
        is_far = np.abs(residual) > OUTLIER * 1.4826 * np.median(np.abs(residual))
        is_isolated = ~np.roll(is_far, 1) & ~np.roll(is_far, -1)
        use = ~(is_far & is_isolated)  # several in a row are no outliers
    return Estimate(
        model=replace(axis, loop_shape=shape),
        weights=weights,
        zeros=_split(scale_m * coefficient[regression.members("zero")], estimate.zeros),
        wide=wide / columns.scale,
        coefficient=coefficient,
        shift=float(np.sqrt(np.mean(change_m[use] ** 2) / np.mean(residual[use] ** 2))),
        variance=dict(zip(regression.labels, ridge.variance.tolist(), strict=True)),
        noise=ridge.noise,
        parameters=parameters,
        residual_m=scale_m * residual,
        use=use,
        rows=estimate.rows,
    )


def _damped(
    present: Estimate,
    solution: Estimate,
    pieces: Sequence[PieceRows],
    columns: Columns,
    regression: Regression,
) -> Estimate:
    """Return a solution, or the largest share of its change that the simulation confirms.

    The reading is a product of the class and the weights of histories, passed through a nonlinear
    sensor: the error of a linearised solution may be a hundred times the predicted one. A step of
    the zero is in the regression but not in the simulation, and is subtracted from its error.
    """
    scale_m, step, use = half_range_m(solution.model), regression.members("step"), solution.use
    step_m = scale_m * regression.design[:, step] @ solution.coefficient[step]
    present_m, predicted_m = regression.error_m - step_m, solution.residual_m
    limit_m = TOLERANCE * max(_rms(present_m, use), _rms(predicted_m, use))
    damped = solution
    for share in SHARES:
        damped = solution if share == 1.0 else interpolated(present, solution, share)
        residual_m = residual_of(damped, pieces, columns) - step_m
        if _rms(residual_m, use) <= limit_m:
            break
    if damped is solution:
        return solution
    noise = float(np.mean((residual_m[use] / scale_m) ** 2))
    return replace(damped, residual_m=residual_m, noise=noise)


def _rms(values: Array, use: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(values[use] ** 2)))


def _quality(
    axis: AxisModel, final: Estimate, regression: Regression, held_out_m: float
) -> FitQuality:
    """Return the errors of the fit; the model does not contain a step of the zero."""
    residual_m = final.residual_m[final.use]
    power_with_step = float(np.mean(residual_m**2))
    step = regression.members("step")
    if len(step):
        step_motion = regression.design[:, step] @ final.coefficient[step]
        step_motion = step_motion - np.mean(step_motion[final.use])
        residual_m = residual_m + half_range_m(axis) * step_motion[final.use]
    power = float(np.mean(residual_m**2))
    rms_m, step_rms_m = float(np.sqrt(power)), float(np.sqrt(max(power - power_with_step, 0.0)))
    is_tested = axis.quality.is_tested
    quality = replace(
        axis.quality,
        rms_m=rms_m,
        held_out_rms_m=float(np.hypot(held_out_m, step_rms_m)) if is_tested else rms_m,
        held_out_kind=BLOCKS if is_tested else IN_SAMPLE,
        rows=len(residual_m),
        effective_parameters=final.parameters,
    )
    return with_noise_bound(quality)


def _converged(
    estimate: Estimate, pieces: Sequence[PieceRows], columns: Columns, regression: Regression
) -> Estimate:
    """Solve class and histories until the simulated error no longer decreases.

    The response is a product of the class's coefficients and the weights of histories. Each joint
    solve is linearised. If it has to be damped, the class is also solved with the present weights
    as an alternative. The weights are then solved again for the class of each candidate. The
    response is linear in either. On the recordings of a scanner damped joint solves alone had a
    residual of 5 or 10 nm, depending on the number of threads.
    """
    best: Estimate | None = None
    for _ in range(FINAL_SOLVES):
        if best is not None:
            estimate = best
            regression = _updated_regression(estimate, pieces, columns, regression)
        joint = _solved(estimate, columns, regression, steps=0)
        candidates = [_damped(estimate, joint, pieces, columns, regression)]
        if candidates[0] is not joint:
            weights, members = estimate.weights, regression.members("initial state")
            fixed = regression.without(np.isin(regression.family, "initial state"))
            of_histories = regression.design[:, members] @ np.concatenate(weights)
            fixed = replace(fixed, target=fixed.target - of_histories)
            class_only = _solved(estimate, columns, fixed, steps=0)
            coefficient = class_only.coefficient.copy()
            coefficient[members] = np.concatenate(weights)
            class_only = replace(
                class_only,
                weights=weights,
                coefficient=coefficient,
                parameters=joint.parameters,  # the effective number of the joint solution
            )
            candidates.append(_damped(estimate, class_only, pieces, columns, regression))
        complete = []
        for candidate in candidates:
            histories = _updated_regression(
                candidate, pieces, columns, regression, has_class=False
            )
            complete.append(_solved_histories(candidate, columns, histories))
        solution = min(complete, key=_mean_square)
        if best is not None and _mean_square(solution) >= _mean_square(best):
            break
        best = solution
        if _mean_square(best) <= ENOUGH**2 * _mean_square(joint):
            break
    assert best is not None
    return best


def _mean_square(estimate: Estimate) -> float:
    return float(np.mean(estimate.residual_m[estimate.use] ** 2))


def _solved_histories(estimate: Estimate, columns: Columns, regression: Regression) -> Estimate:
    """Solve a regression without class for the weights of histories, the zeros and the step.

    The response is linear in these, so that the residual is the error of the simulation.
    """
    total = total_of(regression.moments)
    solved = ridge_of(estimate, regression, total).mean(total)
    scale_m = half_range_m(estimate.model)
    return replace(
        estimate,
        weights=_split(solved[regression.members("initial state")], estimate.weights),
        zeros=_split(scale_m * solved[regression.members("zero")], estimate.zeros),
        coefficient=np.concatenate([estimate.wide * columns.scale, solved]),
        residual_m=scale_m * (regression.target - regression.design @ solved),
    )


def _split(values: Array, like: Sequence[Array]) -> tuple[Array, ...]:
    """Split values into arrays of the same lengths as others."""
    return tuple(np.split(values, np.cumsum([len(array) for array in like])[:-1]))


def _updated_regression(
    estimate: Estimate,
    pieces: Sequence[PieceRows],
    columns: Columns,
    regression: Regression,
    *,
    has_class: bool = True,
) -> Regression:
    """Linearise the reading at a new estimate, with the step of the previous regression."""
    updated = regression_of(estimate, pieces, columns, has_numbers=False, has_class=has_class)
    step = regression.members("step")
    return with_step_column(updated, regression.design[:, step[0]]) if len(step) else updated
