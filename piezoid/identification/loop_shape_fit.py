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
    regression_of,
    residual_of,
    with_numbers,
    with_sensor_numbers,
    with_static_response,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import BLOCKS, IN_SAMPLE, FitQuality, with_noise_bound
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import FamilyRidge, Moments
from piezoid.operators.wide_hysteresis import coefficients
from piezoid.records.recording import Recording

MIN_ROWS = 500
MAX_ITERATIONS = 8
FINAL_SOLVES = 5  # at most, with the final prior
ENOUGH = 1.005  # error before a solve over that after it, up to which no further solve is made
MAX_RATIO = 0.97  # of each error to that without loop shape: a smaller gain is not worth the class
MAX_STEP_RATIO = 0.9  # held-out error with a step of the zero over that without
# Explained error with a step over the noise: if there are other errors, a step represents those.
# For a true jump of the zero it was 1.0; for a periodic error with a wrong phase 1.3 and 1.65, and
# the model fitted together with that step, but used without it, had an error of 25 nm, not 18.
# The error without the step must exceed this limit. Beside hum the noise of the fit was 12.6 times
# too large, and a step that the data do not contain left 4.2 times the true noise instead of 2.0.
MAX_NOISE_RATIO = 1.2
OUTLIER = 7.0  # robust standard deviations
MAX_SHIFT = 0.02  # of the residual: a larger change by lag and extensions needs new columns
# Weight of the change of histories and numbers over that of their rows. On a stage with a lag and
# creep the undamped change had 28 times the predicted error. Shorter steps in its direction ended
# at 2.0 times the noise on left-out blocks, damped ones at 1.3 times.
DAMPINGS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)
MIN_GAIN = 0.1  # of the predicted reduction of the mean square
TOLERANCE = 1.01  # of the simulated mean square over the predicted one
# Phase by which the lag delays the fastest drive, rad. Beside a gain change and an initial state
# the plays had a lag of 7.5 ms, several periods of a chirp: loop shape left 22 times the noise.
MAX_PHASE = 1.0


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
    estimate, columns, regression = _start(axis, pieces, reference)
    errors_before = errors_without_shape(axis, regression)
    if _has_ambiguous_lag(axis, pieces):
        without_lag = replace(axis, lag=replace(axis.lag, time_s=0.0))
        candidates = (estimate, columns, regression), _start(without_lag, pieces, reference)
        estimate, columns, regression = min(
            candidates, key=lambda candidate: _predicted_mean_square(pieces, *candidate)
        )
    for _ in range(MAX_ITERATIONS):
        solution = _next_estimate(estimate, pieces, columns, regression)
        gain = _mean_square(regression.error_m, solution) / _mean_square(
            solution.residual_m, solution
        )
        if gain < 1.0 / ENOUGH**2:  # new variances may increase the error a little
            break
        if solution.shift > MAX_SHIFT:  # the columns hold for the previous lag and extensions
            forward = solution.model.forward
            pieces = tuple(
                replace(piece, drive_V=forward.driven_V(piece.voltage_V, piece.where.rate_Hz))
                for piece in pieces
            )
            columns = columns_of(solution.model, pieces, reference)
            solution = with_static_response(solution, pieces, columns)
        estimate = with_sensor_numbers(solution, pieces, columns)
        if estimate.shift <= MAX_SHIFT and gain <= ENOUGH**2:
            break
        regression = regression_of(estimate, pieces, columns)
    regression = regression_of(estimate, pieces, columns, has_numbers=False)
    errors, divisor = errors_of(estimate, regression)
    with_step = with_best_step(estimate, pieces, regression)
    if with_step is not None:
        step_errors, step_divisor = errors_of(estimate, with_step)
        noise = axis.quality.noise_rms_m / abs(half_range_m(axis))
        reaches_noise = step_errors.explained < MAX_NOISE_RATIO * noise < errors.explained
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


def _start(
    axis: AxisModel, pieces: Sequence[PieceRows], reference: tuple[Array, Array]
) -> tuple[Estimate, Columns, Regression]:
    """Return the first estimate with its columns and its regression."""
    columns = columns_of(axis, pieces, reference)
    estimate = first_estimate(axis, pieces, columns)
    return estimate, columns, regression_of(estimate, pieces, columns)


def _has_ambiguous_lag(axis: AxisModel, pieces: Sequence[PieceRows]) -> bool:
    """Return whether the lag is so long for a drive that the error has several minima."""
    frequencies = [
        float(np.std(np.diff(p.voltage_V)) / np.std(p.voltage_V)) * p.where.rate_Hz
        for p in pieces
        if np.ptp(p.voltage_V) > 0.0
    ]
    return axis.lag.time_s * max(frequencies, default=0.0) > MAX_PHASE


def _predicted_mean_square(
    pieces: Sequence[PieceRows], estimate: Estimate, columns: Columns, regression: Regression
) -> float:
    """Return the mean square of the simulated error after one solve."""
    solution = _next_estimate(estimate, pieces, columns, regression)
    return _mean_square(solution.residual_m, solution)


def _next_estimate(
    present: Estimate,
    pieces: Sequence[PieceRows],
    columns: Columns,
    regression: Regression,
    steps: int = 40,
) -> Estimate:
    """Solve a regression with the least damping that the simulation confirms, then the histories.

    The reading contains products of class and weights of histories, and is not linear in the
    numbers of lag and extensions. As in Levenberg-Marquardt, the change of weights and numbers is
    damped until the simulated error falls. The variances maximise the marginal likelihood without
    damping. A step of the zero is in the regression but not in the simulation.

    steps  of the fixed point of the variances
    """
    total = total_of(regression.moments)
    ridge = ridge_of(present, regression, total)
    regression = _within_bounds(regression, regression.change @ ridge.mean(total))
    total = total_of(regression.moments)
    is_history = np.array([name == "initial state" for name in regression.labels])
    ceiling = np.where(is_history, 1.0, np.inf)
    ridge, _, parameters = ridge.maximised(total, ceiling=ceiling, steps=steps)
    histories, numbers = regression.members("initial state"), regression.members("number")
    centre, weight = np.zeros(len(regression.family)), np.zeros(len(regression.family))
    if len(histories):
        centre[histories] = np.concatenate(present.weights)
    for members in (histories, numbers):
        weight[members] = np.diag(total.gram)[members]
    jump = regression.members("step")
    first = max(DAMPINGS.index(present.damping) - 1, 0)
    for damping in DAMPINGS[first:]:
        penalty = Moments(
            gram=np.diag(damping * weight),
            moment=damping * weight * centre,
            square=float(damping * weight @ centre**2),
            count=0,
        )
        coefficient = regression.change @ ridge.mean(total + penalty)
        solution = _solution(present, columns, regression, ridge, coefficient)
        solution = with_static_response(solution, pieces, columns)
        step_m = half_range_m(present.model) * regression.design[:, jump] @ coefficient[jump]
        simulated_m = residual_of(solution, pieces, columns) - step_m
        before = _mean_square(regression.error_m - step_m, solution)
        predicted = _mean_square(solution.residual_m, solution)
        limit = max(before - MIN_GAIN * (before - predicted), TOLERANCE * predicted)
        if _mean_square(simulated_m, solution) <= limit:
            break
    solution = replace(solution, residual_m=simulated_m, parameters=parameters, damping=damping)
    return _with_histories(solution, pieces, columns, step_m)


def _within_bounds(regression: Regression, coefficient: Array) -> Regression:
    """Return the regression without numbers at a bound that would move beyond it."""
    numbers, violates = regression.members("number"), np.zeros(len(regression.family), dtype=bool)
    step = regression.step * coefficient[numbers]
    violates[numbers] = ((regression.value <= regression.lower) & (step < 0.0)) | (
        (regression.value >= regression.upper) & (step > 0.0)
    )
    return regression.without(violates) if violates.any() else regression


def _with_histories(
    estimate: Estimate, pieces: Sequence[PieceRows], columns: Columns, step_m: Array
) -> Estimate:
    """Solve the weights of histories and the zeros for a class, in which the reading is linear.

    step_m  (rows,)  step of the zero
    """
    scale_m = half_range_m(estimate.model)
    regression = regression_of(estimate, pieces, columns, has_numbers=False, has_class=False)
    regression = replace(regression, target=regression.target - step_m / scale_m)
    total = total_of(regression.moments)
    solved = ridge_of(estimate, regression, total).mean(total)
    residual_m = scale_m * (regression.target - regression.design @ solved)
    if _mean_square(residual_m, estimate) >= _mean_square(estimate.residual_m, estimate):
        return estimate
    return replace(
        estimate,
        weights=_split(solved[regression.members("initial state")], estimate.weights),
        zeros=_split(scale_m * solved[regression.members("zero")], estimate.zeros),
        residual_m=residual_m,
    )


def _solution(
    present: Estimate,
    columns: Columns,
    regression: Regression,
    ridge: FamilyRidge,
    coefficient: Array,
) -> Estimate:
    """Return the estimate with the coefficients of a regression, and its predicted residual."""
    axis, scale_m = present.model, half_range_m(present.model)
    numbers = regression.members("number")
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
    weights, use = present.weights, present.use
    if present.variance:  # the first regression has no columns of histories
        weights = _split(coefficient[regression.members("initial state")], weights)
        is_far = np.abs(residual) > OUTLIER * 1.4826 * np.median(np.abs(residual))
        is_isolated = ~np.roll(is_far, 1) & ~np.roll(is_far, -1)
        use = ~(is_far & is_isolated)  # several in a row are no outliers
    return replace(
        present,
        model=replace(axis, loop_shape=shape),
        weights=weights,
        zeros=_split(scale_m * coefficient[regression.members("zero")], present.zeros),
        wide=wide / columns.scale,
        coefficient=coefficient,
        shift=float(np.sqrt(np.mean(change_m[use] ** 2) / np.mean(residual[use] ** 2))),
        variance=dict(zip(regression.labels, ridge.variance.tolist(), strict=True)),
        noise=ridge.noise,
        residual_m=scale_m * residual,
        use=use,
    )


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
    """Solve class and histories until the simulated error no longer decreases."""
    step = regression.design[:, regression.members("step")]
    solution = _next_estimate(estimate, pieces, columns, regression, steps=0)
    for _ in range(FINAL_SOLVES - 1):
        regression = regression_of(solution, pieces, columns, has_numbers=False)
        if step.size:
            regression = with_step_column(regression, step[:, 0])
        following = _next_estimate(solution, pieces, columns, regression, steps=0)
        gain = _mean_square(solution.residual_m, following) / _mean_square(
            following.residual_m, following
        )
        if gain > 1.0:
            solution = following
        if gain <= ENOUGH**2:
            break
    return solution


def _mean_square(residual_m: Array, estimate: Estimate) -> float:
    """Return the mean square over the rows that an estimate uses."""
    return float(np.mean(residual_m[estimate.use] ** 2))


def _split(values: Array, like: Sequence[Array]) -> tuple[Array, ...]:
    """Split values into arrays of the same lengths as others."""
    return tuple(np.split(values, np.cumsum([len(array) for array in like])[:-1]))
