"""From where the search ended to an AxisModel: intervals, certificate, verdict, weaknesses."""

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
from piezoid.identification.streamed.passes import Task
from piezoid.identification.streamed.unseen import held_out
from piezoid.numerics.arrays import Array

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
                *remarks_on_numbers(fitted, spread, starts, stroke_m),
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
