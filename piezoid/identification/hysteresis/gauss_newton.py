"""Minimise the forward output error within bounds by Gauss-Newton steps.

    e = y_off + L Psi(H[u]) - y,     L: lag and declared sensor pole
    min  mean e^2 + ridge |kinks|^2,   within the bounds

kinks are the changes of slope at every threshold (coordinates.py). Whatever the data do not see,
such as a play that never moves or a slope beyond the readings, the ridge sets: no kink there.

The states are followed at the full rate; rows may be thinned. Each linear model is the triangular
factor of [J | e], gathered chunk by chunk.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.forward import Forward
from piezoid.identification.hysteresis.coordinates import Coordinates, operator_of
from piezoid.identification.hysteresis.pieces import Piece, widest_swing
from piezoid.numerics import levenberg_marquardt
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.levenberg_marquardt import Rows, Rule
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.chain import Following
from piezoid.operators.play import thinned_drive

CHUNK = 1024  # rows written together: about the size of the L2 cache
SPARSE = 3  # samples a row, from which on the way from row to row is shorter
QUICK = 0.5  # samples: a declared pole quicker than this acts as a delay
# Thresholds that meet kinks go on in steps that do not end, each worth a ten-thousandth.
CRAWLED = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """Least-squares problem of one fit.

    pieces        the data
    coordinates   what the vector means
    sensor_pole_Hz declared pole behind the operator, or None
    stride        every how many rows count
    longest_lag_s upper bound of the lag
    fixed         names of shared numbers that may not move, such as ``gap``
    ridge         on the squares of all kinks, beside the mean square of the residual
    """

    pieces: Sequence[Piece]
    coordinates: Coordinates
    sensor_pole_Hz: float | None
    stride: int
    longest_lag_s: float
    fixed: tuple[str, ...] = ()
    ridge: float = 0.0

    @cached_property
    def rows(self) -> int:
        """How many rows count."""
        return sum(len(piece.counting(self.stride)) for piece in self.pieces)

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """M and c of the prior rows M theta + c."""
        kinks, constant = self.coordinates.kinks()
        share = np.sqrt(self.ridge * self.rows)
        return share * kinks, share * constant


@dataclass(frozen=True, kw_only=True, eq=False)
class Minimum:
    """Where the search ended.

    theta       (total,)
    rms         of the residual, scaled units
    iterations  Jacobians computed
    gradient    largest scaled derivative that a bound does not hold: 0 at an exact minimum
    converged   whether the search ended of itself
    """

    theta: Array
    rms: float
    iterations: int
    gradient: float
    converged: bool


def minimise(theta: Array, task: Task, *, iterations: int = 30) -> Minimum:
    """Search from ``theta`` for the least forward output error within the bounds."""
    lower, upper = task.coordinates.bounds(task.longest_lag_s)
    for name in task.fixed:
        numbers = task.coordinates.slices[name]
        lower[numbers] = upper[numbers] = theta[numbers]
    swing = widest_swing(task.pieces)

    def within(theta: Array) -> Array:
        return theta if "gap" in task.fixed else task.coordinates.within_reach(theta, swing)

    minimum = levenberg_marquardt.minimise(
        lambda x: _Point(task, x, upper > lower, rms_of(x, task)),
        theta,
        (lower, upper),
        rule=Rule(crawl=CRAWLED, iterations=iterations, easier=5.0, harder=6.0),
        within=within,
    )
    return Minimum(
        theta=minimum.x,
        rms=minimum.point.rms,
        iterations=minimum.iterations,
        gradient=minimum.gradient,
        converged=minimum.converged,
    )


@dataclass(frozen=True, eq=False)
class _Point:
    task: Task
    theta: Array
    moving: NDArray[np.bool_]
    rms: float

    @property
    def cost(self) -> float:
        kinks, constant = self.task.prior
        roughness = float(np.sum((kinks @ self.theta + constant) ** 2)) / self.task.rows
        return self.task.rows * (self.rms**2 + roughness)

    def linearised(self) -> Rows:
        """Return the triangular factor of the columns of the free parameters.

        Parameters of one piece are eliminated in that piece: each piece contributes only a
        triangle of the shared parameters.
        """
        task, moving = self.task, self.moving
        shared = np.flatnonzero(moving[: task.coordinates.shared])
        common = empty_triangle(len(shared) + 1)
        local_rows, numbers = [], []
        for index in range(len(task.pieces)):
            triangle, columns = _piece_triangle(self.theta, task, index, moving)
            count = len(triangle) - len(common)
            local_rows.append(triangle[:count])
            numbers.append(columns[:count])
            common = gather(common, triangle[count:, count:])
        kinks, constant = task.prior
        prior = np.column_stack([kinks[:, shared], kinks @ self.theta + constant])
        common = gather(common, prior, spend=True)
        # The rows of the pieces come first, then those of the shared parameters.
        local = sum(map(len, local_rows))
        factor = np.zeros((local + len(common), local + len(common)), order="F")
        first = 0
        for rows in local_rows:
            stop = first + len(rows)
            factor[first:stop, first:stop] = rows[:, : len(rows)]
            factor[first:stop, local:] = rows[:, len(rows) :]
            first = stop
        factor[local:, local:] = common
        position = np.concatenate([*numbers, shared])
        return Rows(factor=factor[:, :-1], residual=factor[:, -1], numbers=position)


def _piece_triangle(
    theta: Array, task: Task, index: int, moving: NDArray[np.bool_]
) -> tuple[Array, Samples]:
    """Return the factor of one piece and the numbers its columns belong to.

    Once every play has moved, a row does not depend on the memory: it needs the other columns
    only.
    """
    numbers = column_places(task.coordinates, index)
    used_columns = np.append(moving[numbers], True)
    memory = int(np.count_nonzero(used_columns[: task.coordinates.shape.plays]))
    columns = int(np.count_nonzero(used_columns))
    early, later = empty_triangle(columns), empty_triangle(columns - memory)
    end = memory  # a memory that is forgotten stays so
    for _, rows in rows_of(theta, task, index):
        block = rows if used_columns.all() else rows.T[used_columns].T
        if end:
            aware = np.flatnonzero(block[:, :memory].any(axis=1))
            end = int(aware[-1]) + 1 if len(aware) else 0
            early = gather(early, block[:end], spend=True)
        later = gather(later, block[end:, memory:], spend=True)
    early[memory:, memory:] = gather(later, early[memory:, memory:])
    return early, numbers[used_columns[:-1]]


def rms_of(theta: Array, task: Task) -> float:
    """Return the rms of the residual over the rows that count."""
    total, count = 0.0, 0
    for index, piece in enumerate(task.pieces):
        rows = piece.counting(task.stride)
        error = simulate(theta, task, index, piece, rows) - piece.response[rows]
        total += float(error @ error)
        count += len(error)
    return float(np.sqrt(total / count))


def simulate(
    theta: Array, task: Task, index: int, piece: Piece, at: Samples | None = None
) -> Array:
    """Return the model's output over a piece, (samples,), without tangents.

    index  number of the piece of the task whose memory and zero are used
    at     (rows,)  samples to return, increasing; None: all
    """
    coordinates, rate_Hz = task.coordinates, piece.sampling_rate_Hz
    forward = forward_of(theta, task, rate_Hz)
    memory = forward.memory(piece.drive[0], theta[coordinates.memory_slice(index)])
    sample = np.arange(len(piece.drive)) if at is None else at
    is_sparse = SPARSE * len(sample) < len(piece.drive)
    if forward.lag == "delay" and forward.sensor_Hz is None and is_sparse:
        whole_samples = int(np.floor(forward.lag_s * rate_Hz))
        part = forward.lag_s * rate_Hz - whole_samples
        drive, nearest = _thinned_drive(piece, np.maximum(sample - whole_samples, 0))
        output, _ = forward.static(drive, memory, rate_Hz)
        output = (1.0 - part) * output[nearest] + part * output[np.maximum(nearest - 1, 0)]
    else:
        output, _ = forward.static(piece.drive, memory, rate_Hz)
        output = forward.filtered(output, rate_Hz)[sample]
    zero = theta[coordinates.offset_slice(index)]
    position = _knot_position(sample, piece, len(zero))
    return np.asarray(output + np.interp(position, range(len(zero)), zero))


def rows_of(theta: Array, task: Task, index: int) -> Iterator[tuple[Samples, Array]]:
    """Yield the rows of a piece that count, in chunks: their samples and their derivatives.

    The second is (rows, plays + knots + shared + 1), column-major: derivatives by the numbers of
    ``column_places``, then the residual, model minus measurement. The static columns go through
    lag and sensor like the output.
    """
    coordinates, piece = task.coordinates, task.pieces[index]
    rate_Hz, memory_slope = piece.sampling_rate_Hz, theta[coordinates.memory_slice(index)]
    chain, delay = forward_of(theta, task, rate_Hz).filtered_chain(memory_slope, rate_Hz)
    following = Following(chain, float(piece.drive[0]))
    sample = piece.counting(task.stride)
    drive, source = piece.drive, np.maximum(sample - delay, 0)
    if chain.lag is None and chain.sensor is None and SPARSE * len(sample) < len(drive):
        drive, source = _thinned_drive(piece, source)
    zero = theta[coordinates.offset_slice(index)]
    knots = np.arange(len(zero))
    by_zero = slice(chain.plays, chain.plays + len(knots))
    residual = by_zero.stop + coordinates.shared
    first = start = 0
    while start < len(sample):
        last_source = source[min(start + CHUNK, len(sample)) - 1]
        end = int(np.searchsorted(source, last_source, side="right"))
        rows = sample[start:end]
        block = np.empty((len(rows), by_zero.stop + chain.columns), order="F")
        following.rows(drive[first : last_source + 1], source[start:end] - first, block)
        position = _knot_position(rows, piece, len(knots))
        zero_at_rows = np.interp(position, knots, zero)
        block[:, residual] = block[:, -1] + zero_at_rows - piece.response[rows]
        block[:, by_zero] = np.maximum(1.0 - np.abs(position[:, None] - knots), 0.0)
        yield rows, block[:, : residual + 1]
        first, start = int(last_source) + 1, end


def column_places(coordinates: Coordinates, index: int) -> Samples:
    """Return which numbers of the vector the columns of a piece belong to.

    First its memory slopes, which the rows soon forget, then its zero, then what all share.
    """
    memory, offsets = coordinates.memory_slice(index), coordinates.offset_slice(index)
    return np.asarray(np.r_[memory, offsets, 0 : coordinates.shared])


def forward_of(theta: Array, task: Task, rate_Hz: float) -> Forward:
    """Return the forward model of a vector for a piece of this rate.

    A declared pole far above the sampling rate is a part of a delay.
    """
    operator, lag = operator_of(theta, task.coordinates), task.coordinates.shape.lag
    sensor_Hz = task.sensor_pole_Hz
    forward = Forward(operator=operator, lag=lag, lag_s=operator.lag_s, sensor_Hz=sensor_Hz)
    if sensor_Hz is None or lag != "delay":
        return forward
    time_s = 1.0 / (2 * np.pi * sensor_Hz)
    if time_s * rate_Hz < QUICK:
        return replace(forward, lag_s=operator.lag_s + time_s, sensor_Hz=None)
    return forward


def _thinned_drive(piece: Piece, samples: Samples) -> tuple[Array, Samples]:
    """Return the drive thinned to its turns, some samples and those before, and their rows."""
    return thinned_drive(piece.drive, samples, with_previous=True, turns=piece.turns)


def _knot_position(sample: Samples, piece: Piece, knots: int) -> Array:
    """Return the positions of samples among the knots of a piece's zero, (samples,).

    The knots are spread over the rows that count; before the first and behind the last of them
    the zero stays where it was there.
    """
    position = (sample - piece.first) / max(piece.rows - 1, 1) * (knots - 1)
    return np.asarray(np.clip(position, 0, knots - 1))
