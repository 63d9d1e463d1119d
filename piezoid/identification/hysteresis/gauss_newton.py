"""Minimise the forward output error within bounds by Gauss-Newton steps.

    min  mean e^2 + ridge |kinks|^2,   within the bounds

kinks are the changes of slope at every threshold (coordinates.py). Whatever the data do not see,
such as a play that never moves or a slope beyond the readings, the ridge sets: no kink there.

Each linear model is the triangular factor of [J | e], gathered chunk by chunk.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import Coordinates
from piezoid.identification.hysteresis.pieces import Piece, widest_swing
from piezoid.identification.hysteresis.rows import column_places, rows_of, simulate
from piezoid.numerics import levenberg_marquardt
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import Rows, Rule
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.chain import Samples

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
    def swing(self) -> tuple[float, float]:
        """From where to where the drive goes where it goes furthest without a gap."""
        return widest_swing(self.pieces)

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

    def roughness(self, theta: Array) -> float:
        """Return ridge |kinks|^2."""
        kinks, constant = self.prior
        return float(np.sum((kinks @ theta + constant) ** 2)) / self.rows


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


def rms_of(theta: Array, task: Task) -> float:
    """Return the rms of the residual over the rows that count."""
    total, count = 0.0, 0
    for index, piece in enumerate(task.pieces):
        rows = piece.counting(task.stride)
        output = simulate(theta, task.coordinates, index, piece, task.sensor_pole_Hz, rows)
        error = output - piece.response[rows]
        total += float(error @ error)
        count += len(error)
    return float(np.sqrt(total / count))


def factor_of(theta: Array, task: Task, moving: NDArray[np.bool_]) -> Rows:
    """Return the triangular factor of the columns of the free parameters.

    Parameters of one piece are eliminated in that piece: each piece contributes only a triangle of
    the shared parameters.
    """
    shared = np.flatnonzero(moving[: task.coordinates.shared])
    common = empty_triangle(len(shared) + 1)
    local_rows, numbers = [], []
    for index in range(len(task.pieces)):
        triangle, columns = _piece_triangle(theta, task, index, moving)
        count = len(triangle) - len(common)
        local_rows.append(triangle[:count])
        numbers.append(columns[:count])
        common = gather(common, triangle[count:, count:])
    kinks, constant = task.prior
    prior = np.column_stack([kinks[:, shared], kinks @ theta + constant])
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
    for rows in rows_of(
        theta,
        task.coordinates,
        index,
        task.pieces[index],
        sensor_pole=task.sensor_pole_Hz,
        stride=task.stride,
    ):
        block = rows.block if used_columns.all() else rows.block.T[used_columns].T
        if end:
            aware = np.flatnonzero(block[:, :memory].any(axis=1))
            end = int(aware[-1]) + 1 if len(aware) else 0
            early = gather(early, block[:end], spend=True)
        later = gather(later, block[end:, memory:], spend=True)
    early[memory:, memory:] = gather(later, early[memory:, memory:])
    return early, numbers[used_columns[:-1]]


@dataclass(frozen=True, eq=False)
class _Point:
    task: Task
    theta: Array
    moving: NDArray[np.bool_]
    rms: float

    @property
    def cost(self) -> float:
        return self.task.rows * (self.rms**2 + self.task.roughness(self.theta))

    def linearised(self) -> Rows:
        return factor_of(self.theta, self.task, self.moving)


def minimise(theta: Array, task: Task, *, iterations: int = 30) -> Minimum:
    """Search from ``theta`` for the least forward output error within the bounds."""
    lower, upper = task.coordinates.bounds(task.longest_lag_s)
    for name in task.fixed:
        numbers = task.coordinates.slices[name]
        lower[numbers] = upper[numbers] = theta[numbers]

    def within(theta: Array) -> Array:
        if "gap" in task.fixed:
            return theta
        return task.coordinates.within_reach(theta, task.swing)

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
