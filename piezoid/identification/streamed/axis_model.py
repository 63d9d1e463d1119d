"""From where the search ended to an AxisModel: intervals, certificate, verdict, weaknesses.

The error on rows the fit did not see, when every look at the rows is a pass.

The fit without a part of the data is one Gauss-Newton step from the fit to all of it, on the
triangles of what remains; then the part that was left out is simulated with it. That simulation
is a true one: only the refit is linearised.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.applicability import UNEXPLAINED, reason_in_loops
from piezoid.identification.hysteresis.certificate import certify
from piezoid.identification.hysteresis.estimate import starts_of
from piezoid.identification.hysteresis.gauss_newton import Minimum
from piezoid.identification.hysteresis.gauss_newton import Task as WholeTask
from piezoid.identification.hysteresis.jackknife import Jackknife, left_out
from piezoid.identification.hysteresis.physical import physical
from piezoid.identification.hysteresis.remarks import remarks_on_numbers
from piezoid.identification.hysteresis.search import Fitted
from piezoid.identification.hysteresis.start import Start
from piezoid.identification.hysteresis.summary import summarise
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import FitQuality, Order, Verdict
from piezoid.identification.streamed.convex import Tried
from piezoid.identification.streamed.descent import Reached
from piezoid.identification.streamed.passes import Block, Task, gathered, rows_of_stream
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import Rows

KEPT = 200_000  # residuals, for their quantiles
HARDLY = 0.01  # of what all rows know of a number: the square of its column
SURE = 1e-8  # damping: directions that the rest of the data hardly sees keep the fit's values

NOTICE = (
    "Fitted in blocks, as a recording larger than memory is: no dynamics, no envelope, no other "
    "kind of lag than a delay, no search for transients, no diagnosis."
)
LOOKED_AT = 100_000  # samples of the beginning in which loops are looked at
A_BRANCH = 200  # samples of a branch suffice for that


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What the search of one axis brought.

    turns     how often the drive of each piece turns back
    left_out  pieces that were too short, or too many
    """

    axis: str
    start: Start
    reached: Reached
    task: Task
    tried: Sequence[Tried]
    turns: tuple[int, ...]
    left_out: int


def axis_model(found: Found) -> AxisModel:
    """Return the axis, with how well it is known."""
    task, reached = found.task, found.reached
    streams, scales = task.streams, task.streams[0].scales
    stroke_m = abs(scales.displacement_m)
    fitted, spread = _as_fitted(found), _jackknife(reached, task)
    residual, kind = held_out(reached, task)
    starts = starts_of(fitted, scales)
    quality = _quality(found, residual, kind, stroke_m)
    against = _against(found, quality)
    return AxisModel(
        axis=found.axis,
        hysteresis=physical(
            fitted.operator, scales, float(np.mean([start.zero_m.mean() for start in starts]))
        ),
        polarity=int(np.sign(scales.displacement_m)),
        lag=Lag(kind=fitted.shape.lag, time_s=fitted.operator.lag_s),
        rig=streams[0].rig,
        starts=starts,
        voltage_V=(
            min(stream.held.voltage_V[0] for stream in streams),
            max(stream.held.voltage_V[1] for stream in streams),
        ),
        verdict=Verdict(
            applies=not against,
            reason=against,
            remarks=(
                NOTICE,
                *_about_pieces(found, kind),
                *remarks_on_numbers(fitted),
            ),
        ),
        quality=quality,
        uncertainty=summarise(spread, task.coordinates, scales),
        certificate=certify(
            spread,
            task.coordinates,
            scales,
            residual * stroke_m,
            max(stream.held.step_V * stream.rate_Hz for stream in streams),
            task.longest_lag_s,
        ),
    )


def _as_fitted(found: Found) -> Fitted:
    """Return the fit in the form from which memories and sentences are made."""
    task, reached = found.task, found.reached
    return Fitted(
        task=WholeTask(
            pieces=task.pieces,
            coordinates=task.coordinates,
            sensor_pole_Hz=task.sensor_pole_Hz,
            stride=task.stride,
            longest_lag_s=task.longest_lag_s,
        ),
        minimum=Minimum(
            theta=reached.theta,
            rms=reached.rms,
            iterations=reached.passes,
            gradient=reached.gradient,
            converged=reached.converged,
        ),
        kkt_gap=found.start.kkt_gap,
    )


def _jackknife(reached: Reached, task: Task) -> Jackknife:
    """Return the fit without each block, from the blocks' triangles: R'R is J'J."""
    wide = [block.wide(task.coordinates) for block in reached.blocks]
    normals = np.array([rows[:, :-1].T @ rows[:, :-1] for rows in wide])
    gradients = np.array([rows[:, :-1].T @ rows[:, -1] for rows in wide])
    return left_out(reached.theta, task.bounds(), normals, gradients)


def _quality(found: Found, residual: Array, kind: str, stroke_m: float) -> FitQuality:
    held = [stream.held for stream in found.task.streams]
    shape = found.task.coordinates.shape
    return FitQuality(
        rms_m=found.reached.rms * stroke_m,
        held_out_rms_m=float(np.sqrt(np.mean(residual**2))) * stroke_m,
        held_out_kind=kind,
        range_m=max(piece.displacement_m[1] - piece.displacement_m[0] for piece in held),
        noise_rms_m=max(piece.noise_m for piece in held),
        rows=sum(block.rows for block in found.reached.blocks),
        kkt_gap=found.start.kkt_gap,
        gradient=found.reached.gradient,
        converged=found.reached.converged,
        orders=tuple(
            Order(
                plays=tried.shape.plays,
                dead_zones=tried.shape.below + tried.shape.above,
                bends=0,
                lag=shape.lag,
                held_out_rms_m=tried.held_out * stroke_m,
            )
            for tried in found.tried
        ),
    )


def _against(found: Found, quality: FitQuality) -> str:
    """Return why the class does not apply: loops of the beginning, or what the fit leaves."""
    excerpts = []
    for stream, turns in zip(found.task.streams, found.turns, strict=True):
        branch = stream.samples // (turns + 1)
        excerpts.append(stream.excerpt(LOOKED_AT, max(1, branch // A_BRANCH)))
    against = reason_in_loops(excerpts)
    share = quality.held_out_rms_m / quality.range_m
    if against or share <= UNEXPLAINED:
        return against
    return (
        f"the best fit leaves {100 * share:.1f} % of the displacement range on held-out data; "
        "plays, dead zones and a delay are not what this response is made of"
    )


def _about_pieces(found: Found, kind: str) -> list[str]:
    said = []
    if found.left_out:
        said.append(
            f"{found.left_out} uninterrupted stretches were left out: too short, at rest, or "
            "beyond the longest that are fitted."
        )
    if kind == "second half":
        said.append(
            "Held-out error is from the second half of the only recording; another excitation "
            "would test the model harder."
        )
    return said


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
