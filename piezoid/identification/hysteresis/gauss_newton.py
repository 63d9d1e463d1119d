"""Minimise the forward output error within bounds by Gauss-Newton steps.

    e = y_off + L Psi(H[u]) - y,     L: lag and declared sensor pole
    min  mean e^2 + ridge |kinks|^2,   within the bounds

kinks are the changes of slope at every threshold (coordinates.py). The ridge removes kinks that
the data do not determine, such as a play that never moves or a slope beyond the readings. The
joint fit adds extensions with numbers and priors of their own.

The states are computed at the full rate; rows may be thinned. Each linear model is the triangular
factor of [J | e], gathered chunk by chunk.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.forward import UNSCALED, Forward, Run, Scaled
from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Shape,
    envelope_stretch,
    operator_of,
)
from piezoid.identification.hysteresis.pieces import Piece, PieceStart, Scales
from piezoid.numerics import levenberg_marquardt
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.levenberg_marquardt import Rows, Rule
from piezoid.numerics.quadratic_program import empty_triangle, gather

FAST_POLE = 0.5  # samples: a declared pole with a shorter time constant acts as a delay
# Thresholds at kinks take endless small steps, each of which gains a ten-thousandth of the cost.
MIN_PROGRESS = 1e-3
QUASI_STATIC = Rule(crawl=MIN_PROGRESS, easier=5.0, harder=6.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """Least-squares problem of one fit.

    pieces         the data
    coordinates    layout of the parameter vector
    sensor_pole_Hz declared pole behind the operator, or None
    samples        fitted samples of each piece
    longest_lag_s  upper bound of the lag
    fixed          slices of parameters that stay fixed
    swing          range of the drive that limits the thresholds; None: no limit
    ridge          weight of the squared kinks relative to the mean square of the residual
    extensions     in the order in which they act
    scales         of drive and displacement, for extensions
    """

    pieces: Sequence[Piece]
    coordinates: Coordinates
    sensor_pole_Hz: float | None
    samples: Sequence[Samples]
    longest_lag_s: float
    fixed: tuple[slice, ...] = ()
    swing: tuple[float, float] | None = None
    ridge: float = 0.0
    extensions: tuple[Extension, ...] = ()
    scales: Scales = UNSCALED

    @property
    def rows(self) -> int:
        """Number of fitted rows."""
        return sum(map(len, self.samples))

    def extensions_at(self, theta: Array) -> tuple[Extension, ...]:
        """Return the extensions with the numbers of a vector."""
        pairs = zip(self.extensions, self.coordinates.extension_slices, strict=True)
        return tuple(extension.moved_to(theta[numbers]) for extension, numbers in pairs)

    def bounds(self, theta: Array) -> tuple[Array, Array]:
        """Return lower and upper bounds, (total,) each; fixed parameters stay as in ``theta``."""
        lower, upper = self.coordinates.bounds(self.longest_lag_s)
        for extension, numbers in zip(
            self.extensions, self.coordinates.extension_slices, strict=True
        ):
            free = extension.free()
            lower[numbers], upper[numbers] = free.lower, free.upper
        for group in self.fixed:
            lower[group] = upper[group] = theta[group]
        return lower, upper

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """M and c of the prior rows M theta + c: kinks and relations of the extensions.

        The kinks are the weighted changes of slope. For the loading curve these are the play
        weights; for Psi and gamma the differences of neighbouring slopes, outwards from the two
        middle ones, which are 1. A relation of an extension has the weight of one row.
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
        matrices = [share * np.reshape(kinks, (-1, self.coordinates.total))]
        for extension, numbers in zip(
            self.extensions, self.coordinates.extension_slices, strict=True
        ):
            relations = extension.prior()
            if len(relations):
                unit = abs(self.scales.displacement_m) if extension.is_prior_in_metres else 1.0
                matrices.append(np.zeros((len(relations), self.coordinates.total)))
                matrices[-1][:, numbers] = relations / unit
        matrix = np.concatenate(matrices)
        return matrix, np.pad(share * np.array(constant), (0, len(matrix) - len(constant)))


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
    kkt_gap: float

    @cached_property
    def operator(self) -> Scaled:
        """The fitted operator in scaled units."""
        return operator_of(self.theta, self.task.coordinates)

    def simulate(self, index: int, piece: Piece) -> Array:
        """Simulate a piece with the fitted parameters, memory and zero of one piece of the fit."""
        return simulate(self.theta, self.operator, self.task, index, piece)

    def starts(self, scales: Scales) -> tuple[PieceStart, ...]:
        """Return the initial states and zeros of all pieces in SI units."""
        stretch_V = envelope_stretch(self.operator) * scales.voltage_V
        starts = []
        for index, piece in enumerate(self.task.pieces):
            run, _ = run_of(self.theta, self.operator, self.task, index, piece)
            memory = run.forward.memory(float(run.drive[0]), run.memory_slope)
            zero = self.theta[self.task.coordinates.offset_slice(index)]
            start = PieceStart(
                recording=piece.name,
                memory_V=memory * stretch_V,
                zero_m=piece.centre_m + scales.displacement_m * zero,
                first=piece.first,
                last=piece.last,
            )
            starts.append(start)
        return tuple(starts)

    @property
    def shape(self) -> Shape:
        """Shape of the fit; after pruning smaller than requested."""
        return self.task.coordinates.shape


def minimise(
    theta: Array,
    task: Task,
    *,
    iterations: int,
    rule: Rule = QUASI_STATIC,
    kkt_gap: float = 0.0,
) -> HysteresisFit:
    """Minimise the forward output error within the bounds, starting from ``theta``."""
    lower, upper = task.bounds(theta)
    swing = task.swing
    minimum = levenberg_marquardt.minimise(
        lambda x: _Point(task=task, theta=x, is_free=upper > lower),
        theta,
        (lower, upper),
        rule=replace(rule, iterations=iterations),
        within=lambda x: x if swing is None else task.coordinates.within_reach(x, swing),
    )
    return HysteresisFit(
        task=task,
        theta=minimum.x,
        rms=minimum.point.rms,
        gradient=minimum.gradient,
        converged=minimum.converged,
        kkt_gap=kkt_gap,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Point:
    task: Task
    theta: Array
    is_free: NDArray[np.bool_]

    @cached_property
    def rms(self) -> float:
        return rms_of(self.theta, self.task)

    @property
    def cost(self) -> float:
        matrix, constant = self.task.prior
        roughness = float(np.sum((matrix @ self.theta + constant) ** 2)) / self.task.rows
        return self.task.rows * (self.rms**2 + roughness)

    def linearised(self) -> Rows:
        """Return the triangular factor of the columns of the free parameters.

        The parameters of a piece are eliminated in that piece, so that each piece contributes only
        a triangle of the shared parameters. Once every play has moved, rows do not depend on the
        initial memory any more, and only the other columns are gathered.
        """
        task, is_free = self.task, self.is_free
        operator = operator_of(self.theta, task.coordinates)
        shared = task.coordinates.common
        shared = shared[is_free[shared]]
        common = empty_triangle(len(shared) + 1)
        local_rows, indices = [], []
        for index in range(len(task.pieces)):
            of_piece = column_indices(task.coordinates, index)
            is_used = np.append(is_free[of_piece], True)
            memory = int(np.count_nonzero(is_used[: task.coordinates.shape.plays]))
            columns = int(np.count_nonzero(is_used))
            early, later = empty_triangle(columns), empty_triangle(columns - memory)
            end = memory  # rows of the block that depend on the memory; 0 once it is forgotten
            for _, rows in rows_of(self.theta, operator, task, index):
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
        matrix, constant = task.prior
        prior = np.column_stack([matrix[:, shared], matrix @ self.theta + constant])
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
    errors = residuals(theta, task)
    return float(np.sqrt(sum(float(error @ error) for error in errors) / task.rows))


def residuals(theta: Array, task: Task) -> Iterator[Array]:
    """Yield model minus measurement at the fitted rows of each piece, (rows,)."""
    operator = operator_of(theta, task.coordinates)
    for index, (piece, sample) in enumerate(zip(task.pieces, task.samples, strict=True)):
        yield simulate(theta, operator, task, index, piece, sample) - piece.response[sample]


def simulate(
    theta: Array,
    operator: Scaled,
    task: Task,
    index: int,
    piece: Piece,
    samples: Samples | None = None,
) -> Array:
    """Return the output of the model over a piece, (samples,).

    operator  of ``theta``, the same for all pieces
    index     of the piece of the task whose memory and zero are used
    samples   (rows,)  samples to return, increasing; None: all
    """
    sample = np.arange(len(piece.drive)) if samples is None else samples
    run, zero = run_of(theta, operator, task, index, piece)
    position = _knot_position(sample, piece, len(zero))
    return np.asarray(run.reading_at(sample) + np.interp(position, range(len(zero)), zero))


def rows_of(
    theta: Array, operator: Scaled, task: Task, index: int
) -> Iterator[tuple[Samples, Array]]:
    """Yield samples and linearised rows of a piece, in chunks of fitted rows.

    The rows are (rows, plays + knots + shared + 1), column-major: derivatives by the parameters of
    ``column_indices``, then the residual, model minus measurement. The static columns pass lag and
    sensor like the output.
    """
    piece, plays = task.pieces[index], task.coordinates.shape.plays
    run, zero = run_of(theta, operator, task, index, piece)
    knots = np.arange(len(zero))
    for sample, block in run.rows(task.samples[index], len(knots)):
        position = _knot_position(sample, piece, len(knots))
        block[:, -1] += np.interp(position, knots, zero)
        block[:, -1] -= piece.response[sample]
        hats = np.maximum(1.0 - np.abs(position[:, None] - knots), 0.0)
        block[:, plays : plays + len(knots)] = hats
        yield sample, block


def column_indices(coordinates: Coordinates, index: int) -> Samples:
    """Return the parameter indices of the columns of a piece.

    First its memory slopes, which only the first rows depend on, then its zero, then the
    parameters that all pieces share.
    """
    memory, offsets = coordinates.memory_slice(index), coordinates.offset_slice(index)
    return np.asarray(np.r_[memory, offsets, coordinates.common])


def run_of(
    theta: Array, operator: Scaled, task: Task, index: int, piece: Piece
) -> tuple[Run, Array]:
    """Return the simulation of a piece, and the knots of the zero that is added to its reading.

    The reading with extensions may depend on the position: then the constant zero is part of the
    simulation. A declared pole far above the sampling rate is added to a delay.

    index  of the piece of the task whose memory and zero are used
    """
    coordinates, rate_Hz = task.coordinates, piece.sampling_rate_Hz
    lag, lag_s, sensor_Hz = coordinates.shape.lag, operator.lag_s, task.sensor_pole_Hz
    if sensor_Hz is not None and lag == "delay":
        time_s = 1.0 / (2 * np.pi * sensor_Hz)
        if time_s * rate_Hz < FAST_POLE:
            lag_s, sensor_Hz = lag_s + time_s, None
    zero = theta[coordinates.offset_slice(index)]
    constant = float(zero[0]) if task.extensions else 0.0
    run = Run(
        forward=Forward(
            operator=operator,
            lag=lag,
            lag_s=lag_s,
            sensor_Hz=sensor_Hz,
            extensions=task.extensions_at(theta),
            scales=task.scales,
        ),
        command=piece.drive,
        memory_slope=theta[coordinates.memory_slice(index)],
        zero_m=piece.centre_m + task.scales.displacement_m * constant,
        centre_m=piece.centre_m,
        where=piece.where,
        turns=piece.turns,
    )
    return run, zero - constant


def _knot_position(sample: Samples, piece: Piece, knots: int) -> Array:
    """Return the positions of samples among the knots of a piece's zero, (samples,).

    The knots are spread over the fitted rows; before the first and behind the last fitted row the
    zero is constant.
    """
    position = (sample - piece.first) / max(piece.rows - 1, 1) * (knots - 1)
    return np.asarray(np.clip(position, 0, knots - 1))
