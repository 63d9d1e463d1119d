"""An estimate of loop shape after some rounds, and the readings that it simulates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from piezoid.identification.extensions.extension import Extension, Free, Where, free
from piezoid.identification.loop_shape_columns import Columns, Piece, no_loop_shape
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.simulation import zero_of
from piezoid.numerics.arrays import Array

LAG_s = 1e-6  # step of the lag for its derivative


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Loop shape, initial states, zeros, lag and extensions after some rounds.

    model       with loop shape, lag and extensions
    weights     (histories,) of every piece
    zeros       (knots,) of every piece, m
    wide        (columns,)  coefficients of the wide class, of unscaled columns
    coefficient (columns,)  of all columns of the last regression
    shift       of the reading by the last change of lag and extensions, of the residual
    variance    prior variance by family; noise, too
    parameters  effective number of them
    residual_m  (rows,)
    use         (rows,)  whether a row is no outlier
    rows        of every piece
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


def first_estimate(axis: AxisModel, pieces: Sequence[Piece], columns: Columns) -> Estimate:
    """Return the estimate of the plays alone."""
    rows = len(columns.x)
    return Estimate(
        model=replace(axis, loop_shape=no_loop_shape(axis)),
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


def residual_of(estimate: Estimate, pieces: Sequence[Piece], columns: Columns) -> Array:
    """Return the error of the simulation at the rows of all pieces, (rows,) m."""
    errors_m = []
    for k, piece in enumerate(pieces):
        static_m, _ = static_response_of(estimate, k, piece, columns)
        start = replace(piece.start, zero_m=estimate.zeros[k])
        errors_m.append(
            piece.measured_m[piece.rows] - reading_of(estimate.model, piece, start, static_m)
        )
    return np.concatenate(errors_m)


def between(first: Estimate, second: Estimate, share: float) -> Estimate:
    """Return the estimate that is a share of the way from one to another."""

    def part(a: Array, b: Array) -> Array:
        return np.asarray(a + share * (b - a))

    shape, other = first.model.loop_shape, second.model.loop_shape
    assert shape is not None
    assert other is not None
    mixed = replace(
        other,
        plays_weight=shape.plays_weight + share * (other.plays_weight - shape.plays_weight),
        density_m=part(shape.density_m, other.density_m),
        smooth_m=part(shape.smooth_m, other.smooth_m),
    )
    numbers = part(numbers_of(first.model).value, numbers_of(second.model).value)
    return replace(
        second,
        model=with_numbers(replace(second.model, loop_shape=mixed), numbers),
        weights=tuple(map(part, first.weights, second.weights)),
        zeros=tuple(map(part, first.zeros, second.zeros)),
        wide=part(first.wide, second.wide),
    )


def static_response_of(
    estimate: Estimate, k: int, piece: Piece, columns: Columns
) -> tuple[Array, Array]:
    """Return the static response of piece k, and the part of weighted histories, (samples,)."""
    axis, weight, history_m = estimate.model, estimate.weights[k], np.zeros(piece.where.samples)
    if axis.loop_shape is not None and np.any(weight):
        path = columns.paths[k]
        change_m = path.changes_m(axis.loop_shape) @ weight[:, None]
        history_m = path.interpolated(change_m, piece.where.samples)[:, 0]
    static_m = axis.static_m(piece.drive_V, piece.start.memory_V, piece.where.rate_Hz)
    return history_m + static_m, history_m


def reading_of(
    axis: AxisModel, piece: Piece, start: PieceStart, static_m: Array, away_m: float = 0.0
) -> Array:
    """Return the simulated reading at the rows of a piece, (rows,) m.

    away_m  added to every position
    """
    forward = axis.forward
    zero_m = zero_of(start, piece.where.samples) + away_m
    return forward.read(forward.position(static_m, piece.where, zero_m), piece.where)[piece.rows]


def with_sensor_numbers(estimate: Estimate, pieces: Sequence[Piece], columns: Columns) -> Estimate:
    """Fit the numbers of a sensor's error to the readings at the simulated positions.

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
    """Return a sensor's error fitted to readings, and its change relative to the residual."""
    numbers, scale_m = sensor.free(), float(np.std(reading_m))

    def error(steps: Array) -> Array:
        moved = sensor.moved_to(steps * numbers.step)
        simulated_m = np.concatenate(list(map(moved.reading, positions_m, locations)))
        return np.asarray((simulated_m - reading_m) / scale_m)

    first = numbers.value / numbers.step
    bounds = (numbers.lower / numbers.step, numbers.upper / numbers.step)
    fit = least_squares(error, first, bounds=bounds, x_scale="jac")
    before, after = error(first), error(fit.x)
    change = float(np.linalg.norm(after - before) / np.linalg.norm(before))
    return replace(sensor.moved_to(fit.x * numbers.step), std=sensor.std), change


def numbers_of(axis: AxisModel) -> Free:
    """Return the lag, where the model has one, and the numbers of extensions but of the sensor.

    The reading of a periodic error is far from linear in its wavelength: such numbers stay.
    """
    late = free(axis.lag.time_s, 0.0, np.inf, LAG_s)
    frees = [] if axis.lag.kind == "none" else [late]
    frees += [extension.free() for extension in axis.extensions if not is_sensor(extension)]
    value, lower, upper, step = (
        np.concatenate([np.zeros(0), *(getattr(numbers, name) for numbers in frees)])
        for name in ("value", "lower", "upper", "step")
    )
    return Free(value=value, lower=lower, upper=upper, step=step)


def with_numbers(axis: AxisModel, values: Array) -> AxisModel:
    """Return the model with these numbers of lag and extensions."""
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
    """Tell whether an extension is an error of the sensor."""
    return type(extension).reading is not Extension.reading


def half_range_m(axis: AxisModel) -> float:
    """Return half the range of the displacement, negative where it falls as the drive rises."""
    return axis.polarity * 0.5 * axis.quality.range_m
