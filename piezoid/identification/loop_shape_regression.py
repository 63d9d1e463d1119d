"""Regression for loop shape, linearised at the present estimate, and the readings it simulates.

    y - y_estimate + Z c = Z c' + sum_j t_j dy/dp_j + e

Z are the columns of the wide class, of the initial states and of the zeros, c and c' their present
and next coefficients, and t_j the changes of the numbers p_j of lag and extensions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from piezoid.identification.extensions.extension import Extension, Free, free
from piezoid.identification.hysteresis.pieces import PieceStart
from piezoid.identification.loop_shape_columns import (
    Columns,
    PieceRows,
    zero_loop_shape,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import FOLDS, NEVER_OUT
from piezoid.identification.simulation import zero_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import Moments

LAG_STEP_s = 1e-6  # for the derivative by the lag
MIN_CHANGE = 1e-12  # half ranges: a number that changes the readings by less has no effect
SENSOR_STEP = 1e-4  # half ranges, for the derivative of a reading by the position


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Loop shape, initial states, zeros, lag and extensions at one iteration of the fit.

    model       with loop shape, lag and extensions
    weights     (histories,) of every piece
    zeros       (knots,) of every piece, m
    static_m    (samples,) of every piece: static response of the model with the fitted memory
    changes_m   (rows of the path, histories) of every piece: its changes by other histories, m
    wide        (columns,)  coefficients of the wide class, of unscaled columns
    coefficient (columns,)  of all columns of the last regression
    shift       rms change of the reading by the last step of lag and extensions, over the residual
    variance    prior variance by family; empty before the first regression
    noise       noise variance, in squared half ranges
    parameters  effective number of parameters
    residual_m  (rows,)
    use         (rows,)  False for outliers
    rows        number of rows of every piece
    damping     of the change of histories and numbers by the last solve
    """

    model: AxisModel
    weights: tuple[Array, ...]
    zeros: tuple[Array, ...]
    static_m: tuple[Array, ...]
    changes_m: tuple[Array, ...]
    wide: Array
    coefficient: Array
    shift: float
    variance: dict[str, float]
    noise: float
    parameters: float
    residual_m: Array
    use: NDArray[np.bool_]
    rows: tuple[int, ...]
    damping: float


def first_estimate(axis: AxisModel, pieces: Sequence[PieceRows], columns: Columns) -> Estimate:
    """Return the estimate with zero loop shape."""
    rows, model = len(columns.values), replace(axis, loop_shape=zero_loop_shape(axis))
    weights = tuple(np.zeros(path.plays_m.shape[1] - 1) for path in columns.paths)
    return Estimate(
        model=model,
        weights=weights,
        zeros=tuple(np.array(piece.start.zero_m) for piece in pieces),
        static_m=_static_m(model, pieces),
        changes_m=tuple(
            np.zeros((len(path.drive), len(weight)))
            for path, weight in zip(columns.paths, weights, strict=True)
        ),
        wide=np.zeros(len(columns.scale)),
        coefficient=np.zeros(0),
        shift=0.0,
        variance={},
        noise=0.0,
        parameters=0.0,
        residual_m=np.zeros(rows),
        use=np.ones(rows, dtype=bool),
        rows=tuple(len(piece.rows) for piece in pieces),
        damping=0.0,
    )


def with_static_response(
    estimate: Estimate, pieces: Sequence[PieceRows], columns: Columns
) -> Estimate:
    """Simulate the static response of the model of an estimate, and its changes by histories."""
    shape = estimate.model.loop_shape
    assert shape is not None
    return replace(
        estimate,
        static_m=_static_m(estimate.model, pieces),
        changes_m=tuple(path.changes_m(shape) for path in columns.paths),
    )


def _static_m(axis: AxisModel, pieces: Sequence[PieceRows]) -> tuple[Array, ...]:
    return tuple(
        axis.static_m(piece.drive_V, piece.start.memory_V, piece.where.rate_Hz) for piece in pieces
    )


def residual_of(estimate: Estimate, pieces: Sequence[PieceRows], columns: Columns) -> Array:
    """Simulate an estimate and return its error at the rows of all pieces, (rows,) m."""
    errors_m = []
    for k, piece in enumerate(pieces):
        static_m = _history_m(estimate, k, piece, columns) + estimate.static_m[k]
        start = replace(piece.start, zero_m=estimate.zeros[k])
        errors_m.append(
            piece.measured_m[piece.rows] - reading_of(estimate.model, piece, start, static_m)
        )
    return np.concatenate(errors_m)


def _history_m(estimate: Estimate, k: int, piece: PieceRows, columns: Columns) -> Array:
    """Return the contribution of the weighted histories to the static response, (samples,)."""
    change_m = estimate.changes_m[k] @ estimate.weights[k][:, None]
    return columns.paths[k].interpolated(change_m, piece.where.samples)[:, 0]


def reading_of(
    axis: AxisModel, piece: PieceRows, start: PieceStart, static_m: Array, offset_m: float = 0.0
) -> Array:
    """Return the simulated reading at the rows of a piece, (rows,) m.

    offset_m  added to every position
    """
    forward = axis.forward
    zero_m = zero_of(start, piece.where.samples) + offset_m
    return forward.read(forward.position(static_m, piece.where, zero_m), piece.where)[piece.rows]


def with_sensor_numbers(
    estimate: Estimate, pieces: Sequence[PieceRows], columns: Columns
) -> Estimate:
    """Fit the numbers of sensor errors to the readings at the simulated positions.

    A reading is far from linear in the wavelength of a periodic error, so these numbers are not
    among the columns of the regression.
    """
    axis = estimate.model
    if not any(is_sensor(extension) for extension in axis.extensions):
        return estimate
    positions_m, readings_m, masks = [], [], np.split(estimate.use, np.cumsum(estimate.rows)[:-1])
    for k, piece in enumerate(pieces):
        zero_m = zero_of(replace(piece.start, zero_m=estimate.zeros[k]), piece.where.samples)
        static_m = _history_m(estimate, k, piece, columns) + estimate.static_m[k]
        rows = piece.rows[masks[k]]
        positions_m.append(axis.forward.position(static_m, piece.where, zero_m)[rows])
        readings_m.append(piece.measured_m[rows])
    locations, reading_m = [piece.where for piece in pieces], np.concatenate(readings_m)
    scale_m = float(np.std(reading_m))

    def error(steps: Array, sensor: Extension) -> Array:
        changed = sensor.moved_to(steps * sensor.free().step)
        simulated_m = np.concatenate(list(map(changed.reading, positions_m, locations)))
        return np.asarray((simulated_m - reading_m) / scale_m)

    extensions, shift = list(axis.extensions), estimate.shift
    for number, extension in enumerate(axis.extensions):
        if is_sensor(extension):
            numbers = extension.free()
            first = numbers.value / numbers.step
            bounds = (numbers.lower / numbers.step, numbers.upper / numbers.step)
            fit = least_squares(error, first, bounds=bounds, x_scale="jac", args=(extension,))
            start = error(first, extension)
            change = np.linalg.norm(error(fit.x, extension) - start) / np.linalg.norm(start)
            sensor = replace(extension.moved_to(fit.x * numbers.step), std=extension.std)
            positions_m = list(map(sensor.reading, positions_m, locations))
            extensions[number], shift = sensor, max(shift, float(change))
    return replace(estimate, model=replace(axis, extensions=tuple(extensions)), shift=shift)


def numbers_of(axis: AxisModel) -> Free:
    """Return the lag of a model, unless it has none, and the numbers of extensions.

    Numbers of sensor errors are excluded: ``with_sensor_numbers`` fits them.
    """
    frees = []
    if axis.lag.kind != "none":
        frees.append(free(axis.lag.time_s, 0.0, np.inf, LAG_STEP_s))
    frees += [extension.free() for extension in axis.extensions if not is_sensor(extension)]
    value, lower, upper, step = (
        np.concatenate([np.zeros(0), *(getattr(numbers, name) for numbers in frees)])
        for name in ("value", "lower", "upper", "step")
    )
    return Free(value=value, lower=lower, upper=upper, step=step)


def with_numbers(axis: AxisModel, values: Array) -> AxisModel:
    """Return the model with other numbers of lag and extensions, as ``numbers_of`` orders them."""
    lag, extensions = axis.lag, []
    if lag.kind != "none":
        lag, values = replace(lag, time_s=float(values[0])), values[1:]
    for extension in axis.extensions:
        if is_sensor(extension):
            extensions.append(extension)
            continue
        count = len(extension.free().value)
        extensions.append(replace(extension.moved_to(values[:count]), std=extension.std))
        values = values[count:]
    return replace(axis, lag=lag, extensions=tuple(extensions))


def is_sensor(extension: Extension) -> bool:
    """Return whether an extension is an error of the sensor."""
    return type(extension).reading is not Extension.reading


def half_range_m(axis: AxisModel) -> float:
    """Return half the displacement range, negative if it falls as the drive rises."""
    return axis.polarity * 0.5 * axis.quality.range_m


@dataclass(frozen=True, kw_only=True, eq=False)
class Regression:
    """Rows of the regression, with their sums fold by fold.

    design  (rows, columns)  scaled
    target  (rows,)          in half ranges of the displacement
    error_m (rows,)          of the simulation by the present estimate, m
    family  (columns,)       name of each column's family
    change  (columns, columns)  from orthogonalised coefficients to those of ``design``
    use     (rows,)          False for outliers
    fold    (rows,)
    value, lower, upper  (numbers,)  of lag and extensions, with their bounds
    step    (numbers,)       changes of the numbers by coefficients of 1
    knots   number of knots of the zero of every piece
    prior   moments of the priors of the extensions
    """

    design: Array
    target: Array
    error_m: Array
    family: tuple[str, ...]
    change: Array
    use: NDArray[np.bool_]
    fold: NDArray[np.intp]
    value: Array
    lower: Array
    upper: Array
    step: Array
    knots: tuple[int, ...]
    prior: Moments | None = None

    def without(self, columns: NDArray[np.bool_]) -> "Regression":
        """Return the regression with some columns set to 0."""
        return replace(self, design=np.where(columns, 0.0, self.design))

    @cached_property
    def moments(self) -> tuple[Moments, ...]:
        """Moments of every fold, and last of the rows that are never left out."""
        sums = []
        for number in (*range(FOLDS), NEVER_OUT):
            rows = (self.fold == number) & self.use
            x, y = self.design[rows], self.target[rows]
            gram = self.change.T @ (x.T @ x) @ self.change
            moment = self.change.T @ (x.T @ y)
            sums.append(Moments(gram=gram, moment=moment, square=float(y @ y), count=len(y)))
        return tuple(sums) if self.prior is None else (*sums[:-1], sums[-1] + self.prior)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the names of all families in their order."""
        return tuple(dict.fromkeys(self.family))

    def members(self, name: str) -> NDArray[np.intp]:
        """Return the indices of the columns of one family."""
        return np.flatnonzero(np.array(self.family) == name)


def regression_of(
    estimate: Estimate,
    pieces: Sequence[PieceRows],
    columns: Columns,
    *,
    has_numbers: bool = True,
    has_class: bool = True,
) -> Regression:
    """Linearise the reading at an estimate; the coefficients of this regression are the next one.

    The target is the error of the estimate plus the contribution of its linear coefficients.

    has_numbers  whether lag and extensions may change
    has_class    whether the class may change
    """
    axis, is_first, scale_m = estimate.model, not estimate.variance, half_range_m(estimate.model)
    tables = [
        _tables_of_piece(estimate, k, piece, columns, has_numbers, has_class)
        for k, piece in enumerate(pieces)
    ]
    class_tables, histories, zeros, number_tables, errors_m, slopes = zip(*tables, strict=True)
    numbers = numbers_of(axis) if has_numbers else free([], [], [], [])
    by_numbers = np.concatenate(number_tables)
    size = np.sqrt((by_numbers**2).mean(axis=0))
    size[size < MIN_CHANGE] = 1.0
    step = numbers.step / size
    slope = np.concatenate(slopes)[:, None]
    blocks = (np.concatenate(class_tables), block_diag(*histories), block_diag(*zeros))
    counts = [block.shape[1] for block in (*blocks, by_numbers)]
    *starts, count = np.cumsum(counts).tolist()
    design = np.empty((len(by_numbers), count), order="F")
    for columns_of_block, block in zip(
        np.split(design, starts, axis=1), (*blocks, by_numbers / size), strict=True
    ):
        columns_of_block[:] = block
    linear = design[:, : starts[-1]]
    if (slope != 1.0).any():  # of a sensor without errors it is 1
        linear *= slope
    weights = () if is_first else estimate.weights
    zero = np.concatenate(estimate.zeros) / scale_m
    wide = estimate.wide * columns.scale if has_class else np.zeros(0)
    present = np.concatenate([wide, *weights, zero])
    error_m = np.concatenate(errors_m)
    names = np.repeat(["initial state", "zero", "number"], counts[1:]).tolist()
    change = np.eye(count)
    change[: len(wide), : len(wide)] = columns.change[: len(wide), : len(wide)]
    return Regression(
        design=design,
        target=error_m / scale_m + linear @ present,
        error_m=error_m,
        family=(*columns.family[: len(wide)], *names),
        change=change,
        use=estimate.use,
        fold=np.concatenate([piece.fold for piece in pieces]),
        value=numbers.value,
        lower=numbers.lower,
        upper=numbers.upper,
        step=step,
        knots=tuple(len(zero_m) for zero_m in estimate.zeros),
        prior=_prior(axis, step, count) if has_numbers else None,
    )


def _tables_of_piece(
    estimate: Estimate,
    k: int,
    piece: PieceRows,
    columns: Columns,
    has_numbers: bool,
    has_class: bool,
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return the columns of one piece, its error and the slope of its sensor.

    returned  columns of the class, of histories, of the knots of the zero, and of the numbers,
              (rows, columns) each; error, (rows,) m; d reading / d position, (rows,)
    """
    axis, rows, path = estimate.model, len(piece.rows), columns.paths[k]
    scale_m, start = half_range_m(axis), replace(piece.start, zero_m=estimate.zeros[k])
    history_m = _history_m(estimate, k, piece, columns)
    static_m = history_m + estimate.static_m[k]
    reading_m = reading_of(axis, piece, start, static_m)
    first = sum(estimate.rows[:k])
    of_class, histories = np.zeros((rows, 0)), np.zeros((rows, 0))
    if has_class:
        of_class = columns.values[first : first + rows]
    if estimate.variance:  # not in the first regression
        histories = path.filtered(estimate.changes_m[k], axis, piece) / abs(scale_m)
        if has_class:
            change = path.column_changes(estimate.weights[k], columns.plays, abs(scale_m))
            of_class = of_class + path.filtered(change, axis, piece) / columns.scale
    hats = [replace(start, zero_m=knot) for knot in np.eye(len(start.zero_m))]
    zeros = [zero_of(hat, piece.where.samples)[piece.rows] for hat in hats]
    slope = np.ones(rows)
    if any(is_sensor(extension) for extension in axis.extensions):
        step_m = SENSOR_STEP * abs(scale_m)
        above_m = reading_of(axis, piece, start, static_m, step_m)
        below_m = reading_of(axis, piece, start, static_m, -step_m)
        slope = np.asarray((above_m - below_m) / (2.0 * step_m))
    by_numbers = np.zeros((rows, 0))
    if has_numbers:
        by_numbers_m = _changes_by_numbers_m(
            axis, piece, start, reading_m, static_m, history_m, slope
        )
        by_numbers = by_numbers_m / scale_m
    error_m = piece.measured_m[piece.rows] - reading_m
    return of_class, histories, np.stack(zeros, axis=1), by_numbers, error_m, slope


def _changes_by_numbers_m(
    axis: AxisModel,
    piece: PieceRows,
    start: PieceStart,
    reading_m: Array,
    static_m: Array,
    history_m: Array,
    slope: Array,
) -> Array:
    """Return the change of the reading by a step of every number, (rows, numbers).

    reading_m  (rows,)     of the present model
    history_m  (samples,)  contribution of weighted histories to ``static_m``
    slope      (rows,)     d reading / d position
    """
    numbers = numbers_of(axis)
    changes = np.zeros((len(piece.rows), len(numbers.value)))
    first = int(axis.lag.kind != "none")
    is_inside = dict.fromkeys(range(first), False)  # whether a number acts in the hysteresis
    for extension in axis.extensions:
        if is_sensor(extension):
            continue
        stop = first + len(extension.free().value)
        if type(extension).added_by_number is Extension.added_by_number:
            acts_inside = (
                type(extension).drive is not Extension.drive
                or type(extension).irreversible is not Extension.irreversible
            )
            is_inside |= dict.fromkeys(range(first, stop), acts_inside)
        elif (of_piece := extension.added_by_number(piece.where)) is not None:
            offset, columns = of_piece
            span = slice(first + offset, first + offset + columns.shape[1])
            changes[:, span] = slope[:, None] * columns[piece.rows] * numbers.step[span]
        first = stop
    for k, acts_inside in is_inside.items():
        sign = 1.0 if numbers.value[k] + numbers.step[k] <= numbers.upper[k] else -1.0
        values = numbers.value.copy()
        values[k] += sign * numbers.step[k]
        changed, changed_m = with_numbers(axis, values), static_m
        if acts_inside:
            drive_V = changed.forward.driven_V(piece.voltage_V, piece.where.rate_Hz)
            changed_m = history_m + changed.static_m(drive_V, start.memory_V, piece.where.rate_Hz)
        changes[:, k] = sign * (reading_of(changed, piece, start, changed_m) - reading_m)
    return changes


def _prior(axis: AxisModel, steps: Array, count: int) -> Moments:
    """Return the moments of the priors of the extensions, each relation with the weight of a row.

    steps  (numbers,)  changes of the numbers by coefficients of 1
    count  number of all columns of the regression
    """
    gram, moment, square, rows = np.zeros((count, count)), np.zeros(count), 0.0, 0
    first = int(axis.lag.kind != "none")
    for extension in axis.extensions:
        if is_sensor(extension):
            continue
        stop = first + len(extension.free().value)
        scale = abs(half_range_m(axis)) if extension.is_prior_in_metres else 1.0
        relations = extension.prior() / scale
        if len(relations):
            span = slice(count - len(steps) + first, count - len(steps) + stop)
            change, value = relations * steps[first:stop], relations @ extension.free().value
            gram[span, span] += change.T @ change
            moment[span] -= change.T @ value
            square, rows = square + float(value @ value), rows + len(relations)
        first = stop
    return Moments(gram=gram, moment=moment, square=square, count=rows)
