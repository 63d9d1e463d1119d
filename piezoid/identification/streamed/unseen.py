"""The error on rows the fit did not see, when every look at the rows is a pass.

The fit without a part of the data is one Gauss-Newton step from the fit to all of it, on the
triangles of what remains; then the part that was left out is simulated with it. That simulation
is a true one: only the refit is linearised.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.identification.streamed.descent import Reached
from piezoid.identification.streamed.passes import Block, Task, gathered, rows_of_stream
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import Rows

KEPT = 200_000  # residuals, for their quantiles
HARDLY = 0.01  # of what all rows know of a number: the square of its column
SURE = 1e-8  # damping: directions that the rest of the data hardly sees keep the fit's values


def held_out(reached: Reached, task: Task) -> tuple[Array, str]:
    """Return residuals on what was left out, and what that was, as the fit in memory names it."""
    numbers = sorted({stream.held.recording for stream in task.streams})
    if len(numbers) == 1:
        seen = [b for b in reached.blocks if not _is_late(b, reached.blocks)]
        theta = reached.theta + _refit(reached, task, seen)
        return np.concatenate(
            [_residuals(theta, task, k, late=True) for k in range(len(task.streams))]
        ), "second half"
    found = []
    for fold in range(min(len(numbers), 3)):
        tested = {
            k for k, s in enumerate(task.streams) if numbers.index(s.held.recording) % 3 == fold
        }
        step = _refit(reached, task, [b for b in reached.blocks if b.piece not in tested])
        theta = _settled(reached, task, step, tested)
        found += [_residuals(theta, task, k, late=False) for k in sorted(tested)]
    return np.concatenate(found), "other recordings"


def _is_late(block: Block, blocks: Sequence[Block]) -> bool:
    """Whether a block lies in the second half of its piece."""
    own = [other for other in blocks if other.piece == block.piece]
    before = own[: next(k for k, other in enumerate(own) if other is block)]
    return 2 * sum(b.rows for b in before) + block.rows > sum(b.rows for b in own)


def _refit(reached: Reached, task: Task, blocks: Sequence[Block]) -> Array:
    triangle = gathered(blocks, task.coordinates)
    whole = gathered(reached.blocks, task.coordinates)
    return _step(triangle, whole, reached.theta, task.bounds())


def _step(triangle: Array, whole: Array, theta: Array, bounds: tuple[Array, Array]) -> Array:
    """Return the step to the least error of some rows, which leaves alone what they hardly know.

    A knot of the zero that the last of them just touch would go anywhere for their sake.
    """
    lower, upper = (bound - theta for bound in bounds)
    known, all_of_it = (np.linalg.norm(rows[:, :-1], axis=0) ** 2 for rows in (triangle, whole))
    hardly = known <= HARDLY * all_of_it
    lower[hardly] = upper[hardly] = 0.0
    rows = Rows(factor=triangle[:, :-1], residual=triangle[:, -1])
    return rows.step(lower, upper, SURE)


def _settled(reached: Reached, task: Task, step: Array, tested: set[int]) -> Array:
    """Return the refitted operator with each tested piece's zero and memory fitted to it."""
    theta = reached.theta.copy()
    shared = task.coordinates.shared
    theta[:shared] += step[:shared]
    lower, upper = task.bounds()
    for piece in tested:
        local = task.coordinates.local_slice(piece)
        own = gathered([b for b in reached.blocks if b.piece == piece], task.coordinates)
        error = own[:, -1] + own[:, :shared] @ step[:shared]
        triangle = np.column_stack([own[:, local], error])
        theta[local] += _step(triangle, triangle, theta[local], (lower[local], upper[local]))
    return np.asarray(np.clip(theta, lower, upper))


def _residuals(theta: Array, task: Task, index: int, *, late: bool) -> Array:
    """Simulate a piece and return every so many residuals, of its second half or of all of it."""
    from_sample = task.streams[index].samples // 2 if late else 0
    expected = task.streams[index].samples / task.stride
    every = max(1, int(expected * len(task.streams) / KEPT))
    found, seen = [], 0
    for sample, rows in rows_of_stream(theta, task, index):
        error = rows[sample >= from_sample, -1]
        found.append(error[-seen % every :: every])
        seen += len(error)
    return np.concatenate(found)
