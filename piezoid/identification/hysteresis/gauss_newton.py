"""Bounded Gauss-Newton on the forward output error, with steps judged by the true cost.

    min  mean e^2 + ridge |kinks|^2,   within the bounds

kinks are the changes of slope at every threshold (coordinates.py). Whatever the data do not see,
such as a play that never moves or a slope beyond the readings, the ridge sets: no kink there.

Each iteration gathers the triangular factor of [J | e] chunk by chunk, solves the bounded linear
least-squares problem with a Marquardt term exactly, and accepts the step if the cost falls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import Coordinates
from piezoid.identification.hysteresis.pieces import Piece, widest_swing
from piezoid.identification.hysteresis.rows import column_places, rows_of, simulate
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.chain import Samples

CONVERGED = 1e-5  # relative fall of the cost that is not worth another iteration
# Thresholds that meet kinks go on in steps that do not end, each worth a ten-thousandth.
CRAWL, CRAWLED = 5, 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What is to be minimised.

    pieces        the data
    coordinates   what the vector means
    sensor_pole_Hz declared pole behind the operator, or None
    stride        every how many rows count
    longest_lag_s upper bound of the lag
    held          names of shared numbers that may not move, such as ``gap``
    ridge         on the squares of all kinks, beside the mean square of the residual
    """

    pieces: Sequence[Piece]
    coordinates: Coordinates
    sensor_pole_Hz: float | None
    stride: int
    longest_lag_s: float
    held: tuple[str, ...] = ()
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
        """M and c of rows M theta + c that stand beside those of the data."""
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
    converged   whether the last step changed the cost by less than one part in 1e5, or the last
                five together by less than one in a thousand
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
        output = simulate(theta, task.coordinates, index, piece, task.sensor_pole_Hz)
        error = output[rows] - piece.response[rows]
        total += float(error @ error)
        count += len(error)
    return float(np.sqrt(total / count))


@dataclass(frozen=True, kw_only=True, eq=False)
class Factor:
    """All that a step needs to know of the rows.

    triangle  (places + 1, places + 1)  triangular factor of [J | e] over all pieces
    place     (places,)                 which numbers of the vector the columns belong to
    """

    triangle: Array
    place: Samples


def factor_of(theta: Array, task: Task, moving: NDArray[np.bool_]) -> Factor:
    """Return the factor of the columns of those numbers that may move.

    What only one piece knows is eliminated there: each piece hands on no more than a triangle of
    what all share.
    """
    shared = np.flatnonzero(moving[: task.coordinates.shared])
    common = empty_triangle(len(shared) + 1)
    locals_, places = [], []
    for index in range(len(task.pieces)):
        part, place = _piece_triangle(theta, task, index, moving)
        own = len(part) - len(common)
        locals_.append(part[:own])
        places.append(place[:own])
        common = gather(common, part[own:, own:])
    kinks, constant = task.prior
    prior = np.column_stack([kinks[:, shared], kinks @ theta + constant])
    common = gather(common, prior, spend=True)
    return Factor(triangle=_assembled(locals_, common), place=np.concatenate([*places, shared]))


def _assembled(locals_: Sequence[Array], common: Array) -> Array:
    """Put the rows of the pieces above those of what they share."""
    own = sum(map(len, locals_))
    whole = np.zeros((own + len(common), own + len(common)), order="F")
    first = 0
    for part in locals_:
        last = first + len(part)
        whole[first:last, first:last] = part[:, : len(part)]
        whole[first:last, own:] = part[:, len(part) :]
        first = last
    whole[own:, own:] = common
    return whole


def _piece_triangle(
    theta: Array, task: Task, index: int, moving: NDArray[np.bool_]
) -> tuple[Array, Samples]:
    """Return the factor of one piece and the numbers its columns belong to.

    Once every play has moved, a row knows nothing of the memory: it needs the other columns only.
    """
    places = column_places(task.coordinates, index)
    wanted = np.append(moving[places], True)
    memory = int(np.count_nonzero(wanted[: task.coordinates.shape.plays]))
    columns = int(np.count_nonzero(wanted))
    early, later = empty_triangle(columns), empty_triangle(columns - memory)
    for rows in rows_of(
        theta,
        task.coordinates,
        index,
        task.pieces[index],
        sensor_pole=task.sensor_pole_Hz,
        stride=task.stride,
    ):
        block = rows.block.T[wanted].T
        aware = np.flatnonzero(block[:, :memory].any(axis=1))
        end = int(aware[-1]) + 1 if len(aware) else 0
        early = gather(early, block[:end], spend=True)
        later = gather(later, block[end:, memory:], spend=True)
    early[memory:, memory:] = gather(later, early[memory:, memory:])
    return early, places[wanted[:-1]]


def minimise(theta: Array, task: Task, *, iterations: int = 30) -> Minimum:
    """Search from ``theta`` for the least forward output error within the bounds."""
    lower, upper = task.coordinates.bounds(task.longest_lag_s)
    for name in task.held:
        fixed = task.coordinates.slices[name]
        lower[fixed] = upper[fixed] = theta[fixed]
    theta = np.clip(theta, lower, upper)
    state = Minimum(
        theta=theta, rms=rms_of(theta, task), iterations=0, gradient=np.inf, converged=False
    )
    damping, passed = 1e-3, [_cost(state, task)]
    while state.iterations < iterations and not state.converged:
        factor = factor_of(state.theta, task, upper > lower)
        state, damping = _iterate(state, factor, (lower, upper), task, damping)
        passed.append(_cost(state, task))
        state = replace(state, converged=state.converged or _crawls(passed))
    return state


def _crawls(passed: Sequence[float]) -> bool:
    """Tell whether the last steps together lowered the cost by next to nothing."""
    return len(passed) > CRAWL and 1.0 - passed[-1] / passed[-1 - CRAWL] < CRAWLED


def _cost(state: Minimum, task: Task) -> float:
    return state.rms**2 + task.roughness(state.theta)


def _iterate(
    state: Minimum, found: Factor, bounds: tuple[Array, Array], task: Task, damping: float
) -> tuple[Minimum, float]:
    """Try steps of growing damping until one lowers the cost, or none does."""
    theta, (lower, upper), place = state.theta, bounds, found.place
    factor, residual = found.triangle[:, :-1], found.triangle[:, -1]
    room = lower[place] - theta[place], upper[place] - theta[place]
    scale = np.linalg.norm(factor, axis=0)
    scale[scale == 0.0] = 1.0
    gradient = _free_gradient(factor.T @ residual / scale, *room)
    size = gradient / max(float(np.linalg.norm(residual)), 1e-300)
    before = _cost(state, task)
    for _ in range(12):
        step = np.zeros_like(theta)
        step[place] = bounded_step(
            np.vstack([factor, np.sqrt(damping) * np.diag(scale)]),
            np.concatenate([-residual, np.zeros(len(scale))]),
            *room,
        )
        trial = np.clip(theta + step, lower, upper)
        if "gap" not in task.held:
            trial = task.coordinates.within_reach(trial, task.swing)
        reached = Minimum(
            theta=trial,
            rms=rms_of(trial, task),
            iterations=state.iterations + 1,
            gradient=size,
            converged=False,
        )
        cost = _cost(reached, task)
        if cost < before:
            return (
                replace(reached, converged=1.0 - cost / before < CONVERGED),
                max(damping / 5, 1e-9),
            )
        damping *= 6
    return (
        replace(state, iterations=state.iterations + 1, gradient=size, converged=True),
        damping,
    )


def _free_gradient(gradient: Array, down: Array, up: Array) -> float:
    """Return the largest derivative along which there is still room to move downhill."""
    held = ((down >= 0) & (gradient > 0)) | ((up <= 0) & (gradient < 0))
    return float(np.abs(np.where(held, 0.0, gradient)).max(initial=0.0))
