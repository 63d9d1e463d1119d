"""Bounded Gauss-Newton in which every step costs one pass: cost and Jacobian come together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.streamed.passes import Block, Task, blocks_of, gathered, rms_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step

CONVERGED = 1e-5  # relative fall of the cost that is not worth another pass
MOST_DAMPING = 1e6


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """Where the search stands.

    theta      (total,)
    blocks     triangles there
    rms        of the residual, scaled units
    passes     over the data so far
    gradient   largest scaled derivative that a bound does not hold: 0 at an exact minimum
    converged  whether the last step changed the cost by less than one part in 1e5
    """

    theta: Array
    blocks: Sequence[Block]
    rms: float
    passes: int
    gradient: float
    converged: bool


def descend(theta: Array, task: Task, *, passes: int) -> Reached:
    """Search from ``theta`` for the least forward output error, in so many passes at most."""
    lower, upper = task.bounds()
    for name in task.held:
        fixed = task.coordinates.slices[name]
        lower[fixed] = upper[fixed] = theta[fixed]
    state = _looked(np.clip(theta, lower, upper), task, 1)
    triangle = gathered(state.blocks, task.coordinates)
    damping = 1e-3
    while state.passes < passes and not state.converged and damping < MOST_DAMPING:
        step = step_of(triangle, state.theta, (lower, upper), damping)
        trial = task.coordinates.within_reach(np.clip(state.theta + step, lower, upper))
        tried = _looked(trial, task, state.passes + 1)
        if tried.rms < state.rms:
            gain = 1.0 - (tried.rms / state.rms) ** 2
            state, damping = replace(tried, converged=gain < CONVERGED), max(damping / 5, 1e-9)
            triangle = gathered(state.blocks, task.coordinates)
        else:
            state, damping = replace(state, passes=tried.passes), damping * 6
    at_end = damping >= MOST_DAMPING
    size = _gradient(triangle, state.theta, (lower, upper))
    return replace(state, gradient=size, converged=state.converged or at_end)


def _looked(theta: Array, task: Task, passes: int) -> Reached:
    blocks = blocks_of(theta, task)
    return Reached(
        theta=theta,
        blocks=blocks,
        rms=rms_of(blocks),
        passes=passes,
        gradient=np.inf,
        converged=False,
    )


def step_of(
    triangle: Array, theta: Array, bounds: tuple[Array, Array], damping: float = 0.0
) -> Array:
    """Return the step that makes the linearised error least within the bounds."""
    factor, residual = triangle[:, :-1], triangle[:, -1]
    scale = np.linalg.norm(factor, axis=0)
    scale[scale == 0.0] = 1.0
    return bounded_step(
        np.vstack([factor, np.sqrt(damping) * np.diag(scale)]),
        np.concatenate([-residual, np.zeros(len(scale))]),
        bounds[0] - theta,
        bounds[1] - theta,
    )


def _gradient(triangle: Array, theta: Array, bounds: tuple[Array, Array]) -> float:
    factor, residual = triangle[:, :-1], triangle[:, -1]
    scale = np.linalg.norm(factor, axis=0)
    scale[scale == 0.0] = 1.0
    slope = factor.T @ residual / scale
    held = ((theta <= bounds[0]) & (slope > 0)) | ((theta >= bounds[1]) & (slope < 0))
    height = max(float(np.linalg.norm(residual)), 1e-300)
    return float(np.abs(np.where(held, 0.0, slope)).max(initial=0.0)) / height
