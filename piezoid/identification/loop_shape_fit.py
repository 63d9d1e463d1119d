"""Fit loop shape: the wide class of hysteresis, to what plays with dead zones leave.

    y - y_plays = F(X w) + b P + sum_k a_k D_k + zero + sum_j t_j dy/dp_j + e

X are the columns of ``operators.wide_hysteresis`` along the drive, F the filters behind the
hysteresis, P what plays have beyond their best approximation by the class, D_k the change that
another history of the drive makes in the response of the model, and t_j the errors of the numbers
p_j of lag and extensions. The zero moves between the knots of the fit of the plays. Ridge
regression with one prior variance for each family of columns gives the coefficients. D_k and the
derivatives depend on the last estimate: rounds are made until the numbers are at rest, as in
Gauss-Newton with the linear coefficients eliminated.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.loop_shape import PlainFit
from piezoid.identification.loop_shape_blocks import (
    UNPENALISED,
    Errors,
    beside_step,
    errors_of,
    plain_errors,
    ridge_of,
    total_of,
    with_less_freedom,
    with_step,
)
from piezoid.identification.loop_shape_columns import (
    Columns,
    Piece,
    columns_of,
    no_loop_shape,
    pieces_of,
    with_drive_of,
)
from piezoid.identification.loop_shape_estimate import (
    Estimate,
    between,
    first_estimate,
    half_range_m,
    residual_of,
    with_numbers,
    with_sensor_numbers,
)
from piezoid.identification.loop_shape_regression import Regression, regression_of
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.quality import BLOCKS, IN_SAMPLE, with_noise_bound
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import Moments
from piezoid.operators.wide_hysteresis import coefficients
from piezoid.records.recording import Recording

FEWEST_ROWS = 500
FEWEST_ROUNDS, MOST_ROUNDS = 3, 8
# Solves with less freedom, of which the best is taken. On the bundled axis y the first leaves
# 168 nm, 12.2 nm with its weights of histories solved again; the fifth leaves 11.9 nm. With two
# solves axis x predicts another kind of drive to 0.41 % of the range, with five to 0.25 %.
LAST_ROUNDS = 5
WORTH = 0.97  # each of both errors over that without loop shape: less gain is not worth the class
WORSE = 1.02  # noise variance over the least: lag and extensions no longer improve it
STEP_WORTH = 0.9  # held-out error with a step of the zero over that without
# Explained error with a step over the noise: beside other errors a step follows those. Where the
# zero jumped it was 1.0; where a periodic error had a wrong phase 1.3 and 1.65, and the model that
# was fitted beside that step, and ships without it, left 25 nm in place of 18.
STEP_EXPLAINS = 1.2
FAR = 7.0  # robust standard deviations
SHIFT = 0.02  # of the residual: a larger change by lag and extensions makes columns anew
SHARES = tuple(0.5**k for k in range(6))  # of the change by a solve
CONFIRMED = 1.1  # times the larger error, before or as solved: accepted of a simulation


def with_loop_shape(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with loop shape where that predicts left-out blocks better.

    recordings  of the fit; a recording that the model does not know is ignored
    """
    if axis.loop_shape is not None:
        raise ValueError(f"axis {axis.axis} has loop shape already")
    pieces = pieces_of(axis, recordings)
    if sum(len(piece.rows) for piece in pieces) < FEWEST_ROWS:
        return axis
    columns = columns_of(axis, pieces)
    estimate = first_estimate(axis, pieces, columns)
    regression = regression_of(estimate, pieces, columns)
    plain = plain_errors(axis, regression)
    best = estimate, pieces, columns
    for number in range(MOST_ROUNDS):
        solved = _improved(estimate, columns, regression)
        improved = _damped(estimate, solved, pieces, columns, regression)
        present = estimate.model
        model = replace(improved.model, lag=present.lag, extensions=present.extensions)
        settled = with_sensor_numbers(replace(improved, model=model), pieces, columns)
        if number < FEWEST_ROUNDS - 1 or settled.noise < best[0].noise:
            best = settled, pieces, columns
        elif settled.noise > WORSE * best[0].noise:
            break
        if improved.shift > SHIFT:
            pieces = with_drive_of(improved.model, pieces)
            columns = columns_of(improved.model, pieces)
            estimate = with_sensor_numbers(improved, pieces, columns)
        else:
            estimate = settled
            if number + 1 >= FEWEST_ROUNDS and settled.shift <= SHIFT:
                break
        regression = regression_of(estimate, pieces, columns)
    estimate, pieces, columns = best
    return _accepted(axis, estimate, pieces, columns, plain)


def _improved(
    estimate: Estimate,
    columns: Columns,
    regression: Regression,
    steps: int = 40,
) -> Estimate:
    """Return the next estimate: variances by marginal likelihood, coefficients, lag, outliers.

    steps  of the fixed point of the variances
    """
    axis, scale_m = estimate.model, half_range_m(estimate.model)
    total = total_of(regression.moments())
    ridge = ridge_of(estimate, regression, total)
    outward = regression.outward(regression.change @ ridge.mean(total))
    if outward.any():
        regression = regression.without(outward)
        total = total_of(regression.moments())
    bounded = np.array([name == "initial state" for name in regression.labels])
    ceiling = np.where(bounded, 1.0, np.inf)
    ridge, reduced, parameters = ridge.maximised(total, ceiling=ceiling, steps=steps)
    coefficient = regression.change @ reduced
    residual = regression.target - regression.design @ coefficient
    wide = coefficient[: len(columns.scale)]
    places = regression.places("number")
    change_m = regression.design[:, places] @ coefficient[places]
    if len(places):
        values = regression.value + regression.step * coefficient[places]
        axis = with_numbers(axis, np.clip(values, regression.lower, regression.upper))
    remainder = float(wide[-1] / columns.scale[-1])  # of the plays, beyond the smooth class
    smooth_class = wide / columns.scale - remainder * columns.plays
    density, smooth = coefficients(smooth_class[:-1])
    shape = replace(
        axis.loop_shape or no_loop_shape(axis),
        plays_weight=1.0 + remainder,
        density_m=abs(scale_m) * density,
        smooth_m=abs(scale_m) * smooth,
    )
    weights = estimate.weights
    if estimate.variance:  # the first regression has no columns of histories
        weights = _split(coefficient[regression.places("initial state")], weights)
    use = estimate.use
    if estimate.variance:
        far = np.abs(residual) > FAR * 1.4826 * np.median(np.abs(residual))
        use = ~(far & ~np.roll(far, 1) & ~np.roll(far, -1))  # several in a row are no outliers
    return Estimate(
        model=replace(axis, loop_shape=shape),
        weights=weights,
        zeros=_split(scale_m * coefficient[regression.places("zero")], estimate.zeros),
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
    solved: Estimate,
    pieces: Sequence[Piece],
    columns: Columns,
    regression: Regression,
) -> Estimate:
    """Return a solved estimate, or the largest share of its change that the simulation confirms.

    The reading is a product of the class and the weights of histories, seen by a curved sensor: a
    solve of the linearised reading may leave a hundred times the error it promises. A step of the
    zero is in the regression and not in the simulation, and is subtracted from its error.
    """
    scale_m, step = half_range_m(solved.model), regression.places("step")
    step_m = scale_m * regression.design[:, step] @ solved.coefficient[step]
    before_m = regression.error_m - step_m
    confirmed_m = CONFIRMED * max(_rms(before_m, solved.use), _rms(solved.residual_m, solved.use))
    damped = solved
    for share in SHARES:
        damped = solved if share == 1.0 else between(present, solved, share)
        residual_m = residual_of(damped, pieces, columns) - step_m
        if _rms(residual_m, solved.use) <= confirmed_m:
            break
    if damped is solved:
        return solved
    noise = float(np.mean((residual_m[solved.use] / scale_m) ** 2))
    return replace(damped, residual_m=residual_m, noise=noise)


def _rms(values: Array, use: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(values[use] ** 2)))


def _accepted(
    axis: AxisModel,
    estimate: Estimate,
    pieces: Sequence[Piece],
    columns: Columns,
    plain: Errors,
) -> AxisModel:
    """Return the axis with loop shape, or without where left-out blocks gain too little."""
    regression = regression_of(estimate, pieces, columns, has_numbers=False)
    errors, factor = errors_of(estimate, regression)
    stepped = with_step(estimate, regression)
    if stepped is not None:
        errors_with_step, factor_with_step = errors_of(estimate, stepped)
        noise = axis.quality.noise_rms_m / abs(half_range_m(axis))
        reaches_noise = errors_with_step.explained < STEP_EXPLAINS * noise
        if reaches_noise and errors_with_step.held_out < STEP_WORTH * errors.held_out:
            regression, factor = stepped, factor_with_step
            plain, errors = plain_errors(axis, stepped), errors_with_step
    if errors.held_out > WORTH * plain.held_out or errors.explained > WORTH * plain.explained:
        return replace(axis, loop_shape=None)
    final = _converged(with_less_freedom(estimate, factor), pieces, columns, regression)
    scale_m = abs(half_range_m(axis))
    explained_m = final.residual_m[final.use]
    step = regression.places("step")
    if len(step):  # the model that ships has no step
        moved = regression.design[:, step] @ final.coefficient[step]
        moved = moved - np.mean(moved[final.use])
        explained_m = explained_m + half_range_m(axis) * moved[final.use]
    shape = final.model.loop_shape
    assert shape is not None
    rms_m = float(np.sqrt(np.mean(explained_m**2)))
    held_out_m = float(np.hypot(scale_m * errors.held_out, _step_m(final, explained_m)))
    tested = axis.quality.is_tested  # blocks of a single loop leave nothing that is like them
    quality = replace(
        axis.quality,
        rms_m=rms_m,
        held_out_rms_m=held_out_m if tested else rms_m,
        held_out_kind=BLOCKS if tested else IN_SAMPLE,
        rows=len(explained_m),
        effective_parameters=final.parameters,
    )
    return replace(
        final.model,
        loop_shape=replace(
            shape,
            plain=PlainFit(
                lag_s=axis.lag.time_s,
                rms_m=scale_m * plain.explained,
                held_out_rms_m=scale_m * plain.held_out,
                quality=axis.quality,
                starts=axis.starts,
            ),
        ),
        quality=with_noise_bound(quality),
        starts=_starts(final, pieces),
    )


def _converged(
    estimate: Estimate, pieces: Sequence[Piece], columns: Columns, regression: Regression
) -> Estimate:
    """Return the estimate of the smallest simulated error, of several solves in turn.

    The response is a product of the class's coefficients and the weights of histories. Each solve
    of both is linearised. Where it has to be damped, the class is also solved beside the present
    weights; the weights are then solved again beside the class. The response is linear in either.
    Of a scanner's curve damped solves alone left 5 or 10 nm, by the number of threads.
    """
    solves: list[Estimate] = []
    for _ in range(LAST_ROUNDS):
        if solves:
            estimate = solves[-1]
            regression = _again(estimate, pieces, columns, regression)
        solved = _improved(estimate, columns, regression, steps=0)
        candidates = [_damped(estimate, solved, pieces, columns, regression)]
        if candidates[0] is not solved:
            of_class = _with_class(estimate, solved, columns, regression)
            candidates.append(_damped(estimate, of_class, pieces, columns, regression))
        regressions = [
            _again(candidate, pieces, columns, regression, has_class=False)
            for candidate in candidates
        ]
        complete = map(_with_histories, candidates, repeat(columns), regressions)
        solves.append(min(complete, key=_mean_square))
    return min(solves, key=_mean_square)


def _mean_square(estimate: Estimate) -> float:
    return float(np.mean(estimate.residual_m[estimate.use] ** 2))


def _with_class(
    estimate: Estimate, joint: Estimate, columns: Columns, regression: Regression
) -> Estimate:
    """Return the estimate with the class that fits best beside its weights of histories.

    joint  the solve of both, whose number of parameters holds
    """
    weights = np.concatenate(estimate.weights)
    of_histories = regression.places("initial state")
    fixed = regression.without(np.isin(regression.family, "initial state"))
    by_histories = regression.design[:, of_histories] @ weights
    beside = replace(fixed, target=fixed.target - by_histories)
    solved = _improved(estimate, columns, beside, steps=0)
    coefficient = solved.coefficient.copy()
    coefficient[of_histories] = weights
    return replace(
        solved,
        weights=estimate.weights,
        coefficient=coefficient,
        parameters=joint.parameters,
    )


def _with_histories(estimate: Estimate, columns: Columns, regression: Regression) -> Estimate:
    """Return the estimate with the weights of histories and the zeros that fit its class best.

    Its residual is the error of the simulation.
    """
    total = total_of(regression.moments())
    ridge = ridge_of(estimate, regression, total)
    free = np.isin(regression.family, ("initial state", *UNPENALISED))
    of_class = estimate.wide * columns.scale
    fixed = regression.target - regression.design[:, ~free] @ of_class
    z, y = regression.design[regression.use][:, free], fixed[regression.use]
    sums = Moments(gram=z.T @ z, moment=z.T @ y, square=float(y @ y), count=len(y))
    coefficient = np.zeros(len(free))
    coefficient[~free] = of_class
    coefficient[free] = replace(ridge, family=ridge.family[free]).mean(sums)
    scale_m = half_range_m(estimate.model)
    return replace(
        estimate,
        weights=_split(coefficient[regression.places("initial state")], estimate.weights),
        zeros=_split(scale_m * coefficient[regression.places("zero")], estimate.zeros),
        coefficient=coefficient,
        residual_m=scale_m * (regression.target - regression.design @ coefficient),
    )


def _split(values: Array, like: Sequence[Array]) -> tuple[Array, ...]:
    """Return the values of each piece."""
    return tuple(np.split(values, np.cumsum([len(part) for part in like])[:-1]))


def _again(
    estimate: Estimate,
    pieces: Sequence[Piece],
    columns: Columns,
    regression: Regression,
    *,
    has_class: bool = True,
) -> Regression:
    """Return the regression with the histories' columns of the new estimate, and the same step."""
    fresh = regression_of(estimate, pieces, columns, has_numbers=False, has_class=has_class)
    step = regression.places("step")
    return beside_step(fresh, regression.design[:, step[0]]) if len(step) else fresh


def _step_m(final: Estimate, explained_m: Array) -> float:
    """Return what a step of the zero adds to the residual, rms, m."""
    without = float(np.mean(final.residual_m[final.use] ** 2))
    return float(np.sqrt(max(float(np.mean(explained_m**2)) - without, 0.0)))


def _starts(final: Estimate, pieces: Sequence[Piece]) -> tuple[PieceStart, ...]:
    """Return the starts of all pieces with their zeros and histories."""
    known = {
        id(piece.start): replace(piece.start, zero_m=zero_m, history_weight=weight)
        for piece, zero_m, weight in zip(pieces, final.zeros, final.weights, strict=True)
    }
    return tuple(known.get(id(start), start) for start in final.model.starts)
