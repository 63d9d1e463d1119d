"""Bounded Gauss-Newton on the forward output error, with steps judged by the true cost.

Each iteration gathers the triangular factor of [J | e] chunk by chunk, solves the bounded linear
least-squares problem with a Marquardt term exactly, and accepts the step if the cost falls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.rows import rows_of, simulate
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step
from piezoid.numerics.triangle import empty_triangle, gather

BATCH = 2048  # rows factorised together
CONVERGED = 1e-5  # relative fall of the cost that is not worth another iteration


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What is to be minimised.

    pieces        the data
    coordinates   what the vector means
    sensor_pole_Hz declared pole behind the operator, or None
    stride        every how many rows count
    longest_lag_s upper bound of the lag
    held          names of shared numbers that may not move, such as ``gap``
    """

    pieces: Sequence[Piece]
    coordinates: Coordinates
    sensor_pole_Hz: float | None
    stride: int
    longest_lag_s: float
    held: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Minimum:
    """Where the search ended.

    theta       (total,)
    rms         of the residual, scaled units
    iterations  Jacobians computed
    gradient    largest scaled derivative that a bound does not hold: 0 at an exact minimum
    converged   whether the last step changed the cost by less than one part in 1e5
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
        rows = slice(piece.first, piece.last, task.stride)
        output = simulate(theta, task.coordinates, index, piece, task.sensor_pole_Hz)
        error = output[rows] - piece.response[rows]
        total += float(error @ error)
        count += len(error)
    return float(np.sqrt(total / count))


def triangle_of(theta: Array, task: Task) -> Array:
    """Return the triangular factor of [J | e] over all pieces, (<= total + 1, total + 1)."""
    coordinates = task.coordinates
    whole = empty_triangle(coordinates.total + 1)
    for index in range(len(task.pieces)):
        part = _piece_triangle(theta, task, index)
        local = coordinates.local_slice(index)
        wide = np.zeros((len(part), coordinates.total + 1), order="F")
        wide[:, : coordinates.shared] = part[:, : coordinates.shared]
        wide[:, local] = part[:, coordinates.shared : -1]
        wide[:, -1] = part[:, -1]
        whole = gather(whole, wide)
    return whole


def _piece_triangle(theta: Array, task: Task, index: int) -> Array:
    """Return the factor of one piece; thinned chunks wait until a factorisation is worth it."""
    local = task.coordinates.local_slice(index)
    part = empty_triangle(task.coordinates.shared + local.stop - local.start + 1)
    waiting: list[Array] = []
    for rows in rows_of(
        theta,
        task.coordinates,
        index,
        task.pieces[index],
        sensor_pole=task.sensor_pole_Hz,
        stride=task.stride,
    ):
        waiting.append(np.hstack([rows.tangent, rows.residual[:, None]]))
        if sum(map(len, waiting)) >= BATCH:
            part = gather(part, np.vstack(waiting))
            waiting.clear()
    return gather(part, np.vstack(waiting)) if waiting else part


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
    damping = 1e-3
    while state.iterations < iterations and not state.converged:
        triangle = triangle_of(state.theta, task)
        state, damping = _iterate(state, triangle, (lower, upper), task, damping)
    return state


def _iterate(
    state: Minimum, triangle: Array, bounds: tuple[Array, Array], task: Task, damping: float
) -> tuple[Minimum, float]:
    """Try steps of growing damping until one lowers the cost, or none does."""
    lower, upper = bounds
    factor, residual = triangle[:, :-1], triangle[:, -1]
    scale = np.linalg.norm(factor, axis=0)
    scale[scale == 0.0] = 1.0
    gradient = _free_gradient(factor.T @ residual / scale, state.theta, lower, upper)
    size = gradient / max(float(np.linalg.norm(residual)), 1e-300)
    for _ in range(12):
        step = bounded_step(
            np.vstack([factor, np.sqrt(damping) * np.diag(scale)]),
            np.concatenate([-residual, np.zeros(len(scale))]),
            lower - state.theta,
            upper - state.theta,
        )
        trial = task.coordinates.within_reach(np.clip(state.theta + step, lower, upper))
        rms = rms_of(trial, task)
        if rms < state.rms:
            gain = 1.0 - (rms / state.rms) ** 2
            reached = Minimum(
                theta=trial,
                rms=rms,
                iterations=state.iterations + 1,
                gradient=size,
                converged=gain < CONVERGED,
            )
            return reached, max(damping / 5, 1e-9)
        damping *= 6
    return (
        replace(state, iterations=state.iterations + 1, gradient=size, converged=True),
        damping,
    )


def _free_gradient(gradient: Array, theta: Array, lower: Array, upper: Array) -> float:
    """Return the largest derivative along which the vector may still move downhill."""
    held = ((theta <= lower) & (gradient > 0)) | ((theta >= upper) & (gradient < 0))
    return float(np.abs(np.where(held, 0.0, gradient)).max(initial=0.0))
