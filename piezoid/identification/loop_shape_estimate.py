"""Estimate of loop shape during its iterative fit, and the readings that it simulates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from piezoid.identification.extensions.extension import Extension, Free, Where, free
from piezoid.identification.loop_shape_columns import Columns, PieceRows, zero_loop_shape
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.simulation import zero_of
from piezoid.numerics.arrays import Array

LAG_STEP_s = 1e-6  # for the derivative by the lag


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Loop shape, initial states, zeros, lag and extensions at one iteration of the fit.

    model       with loop shape, lag and extensions
    weights     (histories,) of every piece
    zeros       (knots,) of every piece, m
    wide        (columns,)  coefficients of the wide class, of unscaled columns
    coefficient (columns,)  of all columns of the last regression
    shift       rms change of the reading by the last step of lag and extensions, over the residual
    variance    prior variance by family; empty before the first regression
    noise       noise variance, in squared half ranges
    parameters  effective number of parameters
    residual_m  (rows,)
    use         (rows,)  False for outliers
    rows        number of rows of every piece
    """

    model: AxisModel
    weights: tuple[Array, ...]
    zeros: tuple[Array, ...]
    wide: Array
    coefficient: Array
    shift: float
    variance: dict[str, float]
    noise: float
    parameters: float
    residual_m: Array
    use: NDArray[np.bool_]
    rows: tuple[int, ...]


def first_estimate(axis: AxisModel, pieces: Sequence[PieceRows], columns: Columns) -> Estimate:
    """Return the estimate with zero loop shape."""
    rows = len(columns.values)
    return Estimate(
        model=replace(axis, loop_shape=zero_loop_shape(axis)),
        weights=tuple(np.zeros(path.plays_m.shape[1] - 1) for path in columns.paths),
        zeros=tuple(np.array(piece.start.zero_m) for piece in pieces),
        wide=np.zeros(len(columns.scale)),
        coefficient=np.zeros(0),
        shift=0.0,
        variance={},
        noise=0.0,
        parameters=0.0,
        residual_m=np.zeros(rows),
        use=np.ones(rows, dtype=bool),
        rows=tuple(len(piece.rows) for piece in pieces),
    )


def residual_of(estimate: Estimate, pieces: Sequence[PieceRows], columns: Columns) -> Array:
    """Simulate an estimate and return its error at the rows of all pieces, (rows,) m."""
    errors_m = []
    for k, piece in enumerate(pieces):
        static_m, _ = static_response_of(estimate, k, piece, columns)
        start = replace(piece.start, zero_m=estimate.zeros[k])
        errors_m.append(
            piece.measured_m[piece.rows] - reading_of(estimate.model, piece, start, static_m)
        )
    return np.concatenate(errors_m)


def interpolated(first: Estimate, second: Estimate, share: float) -> Estimate:
    """Interpolate all parameters of two estimates; share 0 is the first, 1 the second."""

    def mix(a: Array, b: Array) -> Array:
        return np.asarray(a + share * (b - a))

    first_shape, second_shape = first.model.loop_shape, second.model.loop_shape
    assert first_shape is not None
    assert second_shape is not None
    first_weight, second_weight = first_shape.plays_weight, second_shape.plays_weight
    shape = replace(
        second_shape,
        plays_weight=first_weight + share * (second_weight - first_weight),
        density_m=mix(first_shape.density_m, second_shape.density_m),
        smooth_m=mix(first_shape.smooth_m, second_shape.smooth_m),
    )
    numbers = mix(numbers_of(first.model).value, numbers_of(second.model).value)
    return replace(
        second,
        model=with_numbers(replace(second.model, loop_shape=shape), numbers),
        weights=tuple(map(mix, first.weights, second.weights)),
        zeros=tuple(map(mix, first.zeros, second.zeros)),
        wide=mix(first.wide, second.wide),
    )


def static_response_of(
    estimate: Estimate, k: int, piece: PieceRows, columns: Columns
) -> tuple[Array, Array]:
    """Simulate the static response of piece k, and the share of its histories, (samples,) each."""
    axis, weight, history_m = estimate.model, estimate.weights[k], np.zeros(piece.where.samples)
    if axis.loop_shape is not None and np.any(weight):
        path = columns.paths[k]
        change_m = path.changes_m(axis.loop_shape) @ weight[:, None]
        history_m = path.interpolated(change_m, piece.where.samples)[:, 0]
    static_m = axis.static_m(piece.drive_V, piece.start.memory_V, piece.where.rate_Hz)
    return history_m + static_m, history_m


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
        static_m, _ = static_response_of(estimate, k, piece, columns)
        rows = piece.rows[masks[k]]
        positions_m.append(axis.forward.position(static_m, piece.where, zero_m)[rows])
        readings_m.append(piece.measured_m[rows])
    locations, reading_m = [piece.where for piece in pieces], np.concatenate(readings_m)
    extensions, shift = list(axis.extensions), estimate.shift
    for number, extension in enumerate(axis.extensions):
        if is_sensor(extension):
            sensor, change = _fitted_sensor(extension, positions_m, locations, reading_m)
            positions_m = list(map(sensor.reading, positions_m, locations))
            extensions[number] = sensor
            shift = max(shift, change)
    return replace(estimate, model=replace(axis, extensions=tuple(extensions)), shift=shift)


def _fitted_sensor(
    sensor: Extension, positions_m: Sequence[Array], locations: Sequence[Where], reading_m: Array
) -> tuple[Extension, float]:
    """Fit a sensor error to readings; return it and its change relative to the residual."""
    numbers, scale_m = sensor.free(), float(np.std(reading_m))

    def error(steps: Array) -> Array:
        changed = sensor.moved_to(steps * numbers.step)
        simulated_m = np.concatenate(list(map(changed.reading, positions_m, locations)))
        return np.asarray((simulated_m - reading_m) / scale_m)

    first = numbers.value / numbers.step
    bounds = (numbers.lower / numbers.step, numbers.upper / numbers.step)
    fit = least_squares(error, first, bounds=bounds, x_scale="jac")
    first_error = error(first)
    change = float(np.linalg.norm(error(fit.x) - first_error) / np.linalg.norm(first_error))
    return replace(sensor.moved_to(fit.x * numbers.step), std=sensor.std), change


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
