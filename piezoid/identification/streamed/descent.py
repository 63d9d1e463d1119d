"""The search in which every step costs one pass: cost and Jacobian come together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.streamed.passes import Block, Task, blocks_of, gathered, rms_of
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import Rows, Rule, minimise


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """Where the search stands.

    theta      (total,)
    blocks     triangles there
    rms        of the residual, scaled units
    passes     over the data so far
    gradient   largest scaled derivative that a bound does not hold: 0 at an exact minimum
    converged  whether the search ended of itself
    """

    theta: Array
    blocks: Sequence[Block]
    rms: float
    passes: int
    gradient: float
    converged: bool


@dataclass(frozen=True, eq=False)
class _Pass:
    task: Task
    blocks: Sequence[Block]

    @property
    def cost(self) -> float:
        return float(sum(np.sum(block.triangle[:, -1] ** 2) for block in self.blocks))

    def linearised(self) -> Rows:
        triangle = gathered(self.blocks, self.task.coordinates)
        return Rows(factor=triangle[:, :-1], residual=triangle[:, -1])


def descend(theta: Array, task: Task, *, passes: int) -> Reached:
    """Search from ``theta`` for the least forward output error, in so many passes at most."""
    lower, upper = task.bounds()
    for name in task.held:
        fixed = task.coordinates.slices[name]
        lower[fixed] = upper[fixed] = theta[fixed]
    found = minimise(
        lambda x: _Pass(task, blocks_of(x, task)),
        theta,
        (lower, upper),
        rule=Rule(evaluations=passes, easier=5.0, harder=6.0),
        within=task.coordinates.within_reach,
    )
    return Reached(
        theta=found.x,
        blocks=found.point.blocks,
        rms=rms_of(found.point.blocks),
        passes=found.evaluations,
        gradient=found.point.linearised().gradient(lower - found.x, upper - found.x),
        converged=found.converged,
    )
