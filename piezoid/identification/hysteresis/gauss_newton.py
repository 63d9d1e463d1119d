"""Minimise the forward output error within bounds by Gauss-Newton steps.

    e = y_off + L Psi(H[u]) - y,     L: lag and declared sensor pole
    min  mean e^2 + ridge |kinks|^2,   within the bounds

kinks are the changes of slope at every threshold (coordinates.py). The ridge removes kinks that
the data do not determine, such as a play that never moves or a slope beyond the readings.

The states are computed at the full rate; rows may be thinned. Each linear model is the triangular
factor of [J | e], gathered chunk by chunk.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.forward import Forward
from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Scaled,
    Shape,
    operator_of,
)
from piezoid.identification.hysteresis.pieces import Piece, widest_swing
from piezoid.numerics import levenberg_marquardt
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.levenberg_marquardt import Rows, Rule
from piezoid.numerics.quadratic_program import empty_triangle, gather
from piezoid.operators.chain import Following
from piezoid.operators.play import thinned_drive

CHUNK = 1024  # rows written together: about the size of the L2 cache
SPARSE = 3  # samples per row, above which computing from row to row is faster
FAST_POLE = 0.5  # samples: a declared pole with a shorter time constant acts as a delay
# Thresholds at kinks take endless small steps, each of which gains a ten-thousandth of the cost.
MIN_PROGRESS = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """Least-squares problem of one fit.

    pieces         the data
    coordinates    layout of the parameter vector
    sensor_pole_Hz declared pole behind the operator, or None
    stride         rows are thinned by this factor
    longest_lag_s  upper bound of the lag
    fixed          names of shared parameters that stay fixed, such as ``gap``
    ridge          weight of the squared kinks relative to the mean square of the residual
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
        """Number of fitted rows."""
        return sum(len(piece.fitted_samples(self.stride)) for piece in self.pieces)

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """M and c of the prior rows M theta + c, the weighted change of slope at every kink.

        For the loading curve these are the play weights; for Psi and gamma the differences of
        neighbouring slopes, outwards from the two middle ones, which are 1.
        """
        kinks, constant = [], []
        for name, group in self.coordinates.slices.items():
            is_slope = name.endswith(("slope", "envelope"))
            if not is_slope and name != "weight":
                continue
            for index in range(group.start if is_slope else group.start + 1, group.stop):
                row = np.zeros(self.coordinates.total)
                row[index] = 1.0
                is_middle_neighbour = is_slope and index == group.start
                if is_slope and not is_middle_neighbour:
                    row[index - 1] = -1.0
                kinks.append(row)
                constant.append(-1.0 if is_middle_neighbour else 0.0)
        share = np.sqrt(self.ridge * self.rows)
        matrix = np.reshape(kinks, (-1, self.coordinates.total))
        return share * matrix, share * np.array(constant)


@dataclass(frozen=True, kw_only=True, eq=False)
class HysteresisFit:
    """Fit of one shape.

    task       the data and the layout of the parameter vector
    theta      (total,)
    rms        of the residual, scaled units
    gradient   largest scaled derivative among parameters off their bounds: 0 at an exact minimum
    converged  False if the search stopped at its maximum number of iterations
    kkt_gap    of the quadratic program that the search started from
    """

    task: Task
    theta: Array
    rms: float
    gradient: float
    converged: bool
    kkt_gap: float = 0.0

    @property
    def operator(self) -> Scaled:
        """The fitted operator in scaled units."""
        return operator_of(self.theta, self.task.coordinates)

    @property
    def shape(self) -> Shape:
        """Shape of the fit; after pruning smaller than requested."""
        return self.task.coordinates.shape


def minimise(theta: Array, task: Task, *, iterations: int) -> HysteresisFit:
    """Minimise the forward output error within the bounds, starting from ``theta``."""
    lower, upper = task.coordinates.bounds(task.longest_lag_s)
    for name in task.fixed:
        group = task.coordinates.slices[name]
        lower[group] = upper[group] = theta[group]
    swing = widest_swing(task.pieces)
    minimum = levenberg_marquardt.minimise(
        lambda x: _Point(task, x, upper > lower, rms_of(x, task)),
        theta,
        (lower, upper),
        rule=Rule(crawl=MIN_PROGRESS, iterations=iterations, easier=5.0, harder=6.0),
        within=lambda x: x if "gap" in task.fixed else task.coordinates.within_reach(x, swing),
    )
    return HysteresisFit(
        task=task,
        theta=minimum.x,
        rms=minimum.point.rms,
        gradient=minimum.gradient,
        converged=minimum.converged,
    )


@dataclass(frozen=True, eq=False)
class _Point:
    task: Task
    theta: Array
    is_free: NDArray[np.bool_]
    rms: float

    @property
    def cost(self) -> float:
        kinks, constant = self.task.prior
        roughness = float(np.sum((kinks @ self.theta + constant) ** 2)) / self.task.rows
        return self.task.rows * (self.rms**2 + roughness)

    def linearised(self) -> Rows:
        """Return the triangular factor of the columns of the free parameters.

        The parameters of a piece are eliminated in that piece, so that each piece contributes only
        a triangle of the shared parameters. Once every play has moved, rows do not depend on the
        initial memory any more, and only the other columns are gathered.
        """
        task, is_free = self.task, self.is_free
        shared = np.flatnonzero(is_free[: task.coordinates.shared])
        common = empty_triangle(len(shared) + 1)
        local_rows, indices = [], []
        for index in range(len(task.pieces)):
            of_piece = column_indices(task.coordinates, index)
            is_used = np.append(is_free[of_piece], True)
            memory = int(np.count_nonzero(is_used[: task.coordinates.shape.plays]))
            columns = int(np.count_nonzero(is_used))
            early, later = empty_triangle(columns), empty_triangle(columns - memory)
            end = memory  # rows of the block that depend on the memory; 0 once it is forgotten
            for _, rows in rows_of(self.theta, task, index):
                block = rows if is_used.all() else rows.T[is_used].T
                if end:
                    with_memory = np.flatnonzero(block[:, :memory].any(axis=1))
                    end = int(with_memory[-1]) + 1 if len(with_memory) else 0
                    early = gather(early, block[:end], spend=True)
                later = gather(later, block[end:, memory:], spend=True)
            early[memory:, memory:] = gather(later, early[memory:, memory:])
            count = len(early) - len(common)
            local_rows.append(early[:count])
            indices.append(of_piece[is_used[:-1]][:count])
            common = gather(common, early[count:, count:])
        kinks, constant = task.prior
        prior = np.column_stack([kinks[:, shared], kinks @ self.theta + constant])
        common = gather(common, prior, spend=True)
        # The rows of the pieces come first, then those of the shared parameters.
        local = sum(map(len, local_rows))
        factor = np.zeros((local + len(common), local + len(common)), order="F")
        first = 0
        for triangle in local_rows:
            stop = first + len(triangle)
            factor[first:stop, first:stop] = triangle[:, : len(triangle)]
            factor[first:stop, local:] = triangle[:, len(triangle) :]
            first = stop
        factor[local:, local:] = common
        free_indices = np.concatenate([*indices, shared])
        return Rows(factor=factor[:, :-1], residual=factor[:, -1], numbers=free_indices)


def rms_of(theta: Array, task: Task) -> float:
    """Return the rms of the residual over the fitted rows."""
    total, count = 0.0, 0
    for index, piece in enumerate(task.pieces):
        rows = piece.fitted_samples(task.stride)
        error = simulate(theta, task, index, piece, rows) - piece.response[rows]
        total += float(error @ error)
        count += len(error)
    return float(np.sqrt(total / count))


def simulate(
    theta: Array, task: Task, index: int, piece: Piece, samples: Samples | None = None
) -> Array:
    """Return the output of the model over a piece, (samples,).

    index    of the piece of the task whose memory and zero are used
    samples  (rows,)  samples to return, increasing; None: all
    """
    coordinates, rate_Hz = task.coordinates, piece.sampling_rate_Hz
    forward = forward_of(theta, task, rate_Hz)
    memory = forward.memory(piece.drive[0], theta[coordinates.memory_slice(index)])
    sample = np.arange(len(piece.drive)) if samples is None else samples
    is_sparse = SPARSE * len(sample) < len(piece.drive)
    if forward.lag == "delay" and forward.sensor_Hz is None and is_sparse:
        whole_samples = int(np.floor(forward.lag_s * rate_Hz))
        fraction = forward.lag_s * rate_Hz - whole_samples
        source = np.maximum(sample - whole_samples, 0)
        drive, nearest = thinned_drive(piece.drive, source, with_previous=True, turns=piece.turns)
        output, _ = forward.static(drive, memory, rate_Hz)
        previous = output[np.maximum(nearest - 1, 0)]
        output = (1.0 - fraction) * output[nearest] + fraction * previous
    else:
        output, _ = forward.static(piece.drive, memory, rate_Hz)
        output = forward.filtered(output, rate_Hz)[sample]
    zero = theta[coordinates.offset_slice(index)]
    position = _knot_position(sample, piece, len(zero))
    return np.asarray(output + np.interp(position, range(len(zero)), zero))


def rows_of(theta: Array, task: Task, index: int) -> Iterator[tuple[Samples, Array]]:
    """Yield samples and linearised rows of a piece, in chunks of fitted rows.

    The rows are (rows, plays + knots + shared + 1), column-major: derivatives by the parameters of
    ``column_indices``, then the residual, model minus measurement. The static columns pass lag and
    sensor like the output.
    """
    coordinates, piece = task.coordinates, task.pieces[index]
    rate_Hz, memory_slope = piece.sampling_rate_Hz, theta[coordinates.memory_slice(index)]
    chain, delay = forward_of(theta, task, rate_Hz).filtered_chain(memory_slope, rate_Hz)
    tangents = Following(chain, float(piece.drive[0]))
    sample = piece.fitted_samples(task.stride)
    drive, source = piece.drive, np.maximum(sample - delay, 0)
    if chain.lag is None and chain.sensor is None and SPARSE * len(sample) < len(drive):
        drive, source = thinned_drive(drive, source, with_previous=True, turns=piece.turns)
    zero = theta[coordinates.offset_slice(index)]
    knots = np.arange(len(zero))
    zero_columns = slice(chain.plays, chain.plays + len(knots))
    residual = zero_columns.stop + coordinates.shared
    first = start = 0
    while start < len(sample):
        last_source = source[min(start + CHUNK, len(sample)) - 1]
        end = int(np.searchsorted(source, last_source, side="right"))
        rows = sample[start:end]
        block = np.empty((len(rows), zero_columns.stop + chain.columns), order="F")
        tangents.rows(drive[first : last_source + 1], source[start:end] - first, block)
        position = _knot_position(rows, piece, len(knots))
        block[:, residual] = block[:, -1] + np.interp(position, knots, zero) - piece.response[rows]
        block[:, zero_columns] = np.maximum(1.0 - np.abs(position[:, None] - knots), 0.0)
        yield rows, block[:, : residual + 1]
        first, start = int(last_source) + 1, end


def column_indices(coordinates: Coordinates, index: int) -> Samples:
    """Return the parameter indices of the columns of a piece.

    First its memory slopes, which only the first rows depend on, then its zero, then the shared
    parameters.
    """
    memory, offsets = coordinates.memory_slice(index), coordinates.offset_slice(index)
    return np.asarray(np.r_[memory, offsets, 0 : coordinates.shared])


def forward_of(theta: Array, task: Task, rate_Hz: float) -> Forward:
    """Return the forward model of a parameter vector at a sampling rate.

    A declared pole far above the sampling rate is added to a delay.
    """
    operator, lag = operator_of(theta, task.coordinates), task.coordinates.shape.lag
    sensor_Hz = task.sensor_pole_Hz
    forward = Forward(operator=operator, lag=lag, lag_s=operator.lag_s, sensor_Hz=sensor_Hz)
    if sensor_Hz is None or lag != "delay":
        return forward
    time_s = 1.0 / (2 * np.pi * sensor_Hz)
    if time_s * rate_Hz < FAST_POLE:
        return replace(forward, lag_s=operator.lag_s + time_s, sensor_Hz=None)
    return forward


def _knot_position(sample: Samples, piece: Piece, knots: int) -> Array:
    """Return the positions of samples among the knots of a piece's zero, (samples,).

    The knots are spread over the fitted rows; before the first and behind the last fitted row the
    zero is constant.
    """
    position = (sample - piece.first) / max(piece.rows - 1, 1) * (knots - 1)
    return np.asarray(np.clip(position, 0, knots - 1))
