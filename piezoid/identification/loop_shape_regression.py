"""One iteration of the fit of loop shape: a regression linearised at the present estimate.

    y - y_estimate + Z c = Z c' + sum_j t_j dy/dp_j + e

Z are the columns of the wide class, of the initial states and of the zeros, c and c' their present
and next coefficients, and t_j the changes of the numbers p_j of lag and extensions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.extensions.extension import Extension, free
from piezoid.identification.loop_shape_columns import (
    FOLDS,
    NEVER_OUT,
    Columns,
    PieceRows,
)
from piezoid.identification.loop_shape_estimate import (
    Estimate,
    half_range_m,
    is_sensor,
    numbers_of,
    reading_of,
    static_response_of,
    with_numbers,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.simulation import zero_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.family_ridge import Moments

MIN_CHANGE = 1e-12  # half ranges: a number that changes the readings by less has no effect
SENSOR_STEP = 1e-4  # half ranges, for the derivative of a reading by the position


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

    def violates_bound(self, coefficient: Array) -> NDArray[np.bool_]:
        """Return for each column whether it would move a number at a bound beyond that bound."""
        numbers = self.members("number")
        step = self.step * coefficient[numbers]
        violates = np.zeros(len(self.family), dtype=bool)
        violates[numbers] = ((self.value <= self.lower) & (step < 0.0)) | (
            (self.value >= self.upper) & (step > 0.0)
        )
        return violates

    def without(self, columns: NDArray[np.bool_]) -> "Regression":
        """Return the regression with some columns set to 0."""
        return replace(self, design=np.where(columns, 0.0, self.design))

    def moments(self) -> tuple[Moments, ...]:
        """Return the moments of every fold, and last of the rows that are never left out."""
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
    has_class    whether the class may change together with the weights of histories: its columns
                 then contain the weighted histories
    """
    axis = estimate.model
    shape = axis.loop_shape
    assert shape is not None
    scale_m, is_first = half_range_m(axis), not estimate.variance
    rows = np.cumsum([0, *estimate.rows])
    knots = np.cumsum([0, *(len(zero_m) for zero_m in estimate.zeros)])
    zeros = np.zeros((rows[-1], knots[-1]))
    histories = [np.zeros((rows[-1], 0 if is_first else len(w))) for w in estimate.weights]
    by_numbers, errors_m, sensor_slopes = [], [], []
    has_histories = has_class and not (is_first or has_numbers)
    x = columns.values.copy() if has_histories else columns.values
    for k, piece in enumerate(pieces):
        start = replace(piece.start, zero_m=estimate.zeros[k])
        of_piece = slice(rows[k], rows[k + 1])
        zeros[of_piece, knots[k] : knots[k + 1]] = _zero_columns(piece, start)
        static_m, history_m = static_response_of(estimate, k, piece, columns)
        if not is_first:
            path = columns.paths[k]
            changes_m = path.filtered(path.changes_m(shape), axis, piece)
            histories[k][of_piece] = changes_m / abs(scale_m)
            if has_histories:
                x[of_piece] += _history_columns(estimate, k, piece, columns)
        reading_m = reading_of(axis, piece, start, static_m)
        errors_m.append(piece.measured_m[piece.rows] - reading_m)
        sensor_slopes.append(_sensor_slope(axis, piece, start, static_m))
        if has_numbers:
            changes_m = _changes_by_numbers_m(axis, piece, start, reading_m, static_m, history_m)
            by_numbers.append(changes_m / scale_m)
    numbers = numbers_of(axis) if has_numbers else free([], [], [], [])
    number_columns, size = _normalised(by_numbers, int(rows[-1]))
    step = numbers.step / size
    sensor_slope = np.concatenate(sensor_slopes)[:, None]
    linear = np.hstack([sensor_slope * table for table in (x, *histories, zeros)])
    present = np.concatenate(
        [
            estimate.wide * columns.scale,
            *(() if is_first else estimate.weights),
            np.concatenate(estimate.zeros) / scale_m,
        ]
    )
    design = np.hstack([linear, number_columns])
    error_m = np.concatenate(errors_m)
    counts = (sum(table.shape[1] for table in histories), zeros.shape[1], len(step))
    names = np.repeat(["initial state", "zero", "number"], counts).tolist()
    change = np.eye(design.shape[1])
    change[: len(columns.scale), : len(columns.scale)] = columns.change
    return Regression(
        design=design,
        target=error_m / scale_m + linear @ present,
        error_m=error_m,
        family=(*columns.family, *names),
        change=change,
        use=estimate.use,
        fold=np.concatenate([piece.fold for piece in pieces]),
        value=numbers.value,
        lower=numbers.lower,
        upper=numbers.upper,
        step=step,
        knots=tuple(len(zero_m) for zero_m in estimate.zeros),
        prior=_prior(axis, step, design.shape[1]) if has_numbers else None,
    )


def _history_columns(estimate: Estimate, k: int, piece: PieceRows, columns: Columns) -> Array:
    """Return the change of the class's columns by weighted histories, (rows, columns)."""
    path, scale_m = columns.paths[k], abs(half_range_m(estimate.model))
    change = path.column_changes(estimate.weights[k], columns.plays, scale_m)
    return path.filtered(change, estimate.model, piece) / columns.scale


def _zero_columns(piece: PieceRows, start: PieceStart) -> Array:
    """Return the derivative of the zero by the value at each of its knots, (rows, knots)."""
    hats = [replace(start, zero_m=knot) for knot in np.eye(len(start.zero_m))]
    return np.stack([zero_of(hat, piece.where.samples)[piece.rows] for hat in hats], axis=1)


def _normalised(tables: Sequence[Array], rows: int) -> tuple[Array, Array]:
    """Scale columns to rms 1; return them and their divisors."""
    columns = np.concatenate(tables) if tables else np.zeros((rows, 0))
    size = np.sqrt((columns**2).mean(axis=0))
    size[size < MIN_CHANGE] = 1.0
    return columns / size, size


def _sensor_slope(axis: AxisModel, piece: PieceRows, start: PieceStart, static_m: Array) -> Array:
    """Return d reading / d position, (rows,)."""
    if not any(is_sensor(extension) for extension in axis.extensions):
        return np.ones(len(piece.rows))
    step_m = SENSOR_STEP * abs(half_range_m(axis))
    above_m, below_m = (
        reading_of(axis, piece, start, static_m, offset_m) for offset_m in (step_m, -step_m)
    )
    return np.asarray((above_m - below_m) / (2.0 * step_m))


def _changes_by_numbers_m(
    axis: AxisModel,
    piece: PieceRows,
    start: PieceStart,
    reading_m: Array,
    static_m: Array,
    history_m: Array,
) -> Array:
    """Return the change of the reading by a step of every number, (rows, numbers).

    reading_m  (rows,)     of the present model
    history_m  (samples,)  contribution of weighted histories to ``static_m``
    """
    numbers = numbers_of(axis)
    changes = np.zeros((len(piece.rows), len(numbers.value)))
    changes_hysteresis = [] if axis.lag.kind == "none" else [False]
    for extension in axis.extensions:
        if not is_sensor(extension):
            count = len(extension.free().value)
            changes_hysteresis += [not _is_behind_hysteresis(extension)] * count
    for k, (step, is_inside) in enumerate(zip(numbers.step, changes_hysteresis, strict=True)):
        sign = 1.0 if numbers.value[k] + step <= numbers.upper[k] else -1.0
        values = numbers.value.copy()
        values[k] += sign * step
        changed, changed_m = with_numbers(axis, values), static_m
        if is_inside:
            drive_V = changed.forward.driven_V(piece.voltage_V, piece.where.rate_Hz)
            changed_m = history_m + changed.static_m(drive_V, start.memory_V, piece.where.rate_Hz)
        changes[:, k] = sign * (reading_of(changed, piece, start, changed_m) - reading_m)
    return changes


def _is_behind_hysteresis(extension: Extension) -> bool:
    kind = type(extension)
    return kind.drive is Extension.drive and kind.irreversible is Extension.irreversible


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
