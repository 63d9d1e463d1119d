"""What holds an axis back most, and the recording or repair that would help."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid_reports.quantities import percent, told

NEAR_NOISE = 2.0
WANDERING = 5e-4  # of the range: a zero that moves further is not sensor noise
LOOSE = 0.2  # of the loop's width: an interval wider than that leaves the width open
FEW_BLOCKS = 10


@dataclass(frozen=True, kw_only=True)
class Weakness:
    """One thing that weakens a fit.

    what    a few words, to follow "what weakens it most is"
    why     one sentence with its number
    remedy  the next experiment or repair
    """

    what: str
    why: str
    remedy: str


Rule = Callable[[AxisModel], Weakness | None]


def weaknesses_of(axis: AxisModel) -> tuple[Weakness, ...]:
    """Return everything that weakens the fit of an axis, the gravest first."""
    return tuple(found for rule in RULES if (found := rule(axis)) is not None)


def _class_does_not_apply(axis: AxisModel) -> Weakness | None:
    if axis.verdict.applies:
        return None
    return Weakness(
        what="that the model class does not apply",
        why=f"The model class does not apply: {axis.verdict.reason}.",
        remedy="Check which column is which and that both channels are sampled at the same "
        "instant, then sweep ten times slower; if the reason stays, another model is needed.",
    )


def _one_excitation(axis: AxisModel) -> Weakness | None:
    if axis.quality.held_out_kind != "second half":
        return None
    return Weakness(
        what="that it was tested on the second half of its only recording",
        why="Only one recording was given, so the held-out error is from its second half and "
        "the drive it was tested on is of the same kind.",
        remedy="Record a second, different drive: reversals of many sizes at another speed.",
    )


def _not_converged(axis: AxisModel) -> Weakness | None:
    if axis.quality.converged:
        return None
    return Weakness(
        what="that the search stopped before it converged",
        why="The search stopped at its limit of iterations; a better fit may exist.",
        remedy="Record reversals of decreasing size over the whole range, which tell neighbouring "
        "plays apart, and fit again with both recordings.",
    )


def _wandering_zero(axis: AxisModel) -> Weakness | None:
    moved = [(float(np.ptp(start.zero_m)), start.recording) for start in axis.starts]
    if not moved or max(moved)[0] <= WANDERING * axis.quality.range_m:
        return None
    by_m, where = max(moved)
    return Weakness(
        what=f"a zero that moves by {told(by_m, 'm')}, unexplained",
        why=f"The zero moves by {told(by_m, 'm')} "
        f"({percent(by_m / axis.quality.range_m)} of the range) during {where}; the fit "
        "followed this, but nothing here explains it.",
        remedy="Step to mid-range and hold the drive constant for ten minutes after warming up: "
        "creep slows down as it goes, thermal drift does not.",
    )


def _far_from_noise(axis: AxisModel) -> Weakness | None:
    quality = axis.quality
    if quality.held_out_rms_m <= NEAR_NOISE * quality.noise_rms_m:
        return None
    return Weakness(
        what=f"an error {_times(quality.held_out_rms_m, quality.noise_rms_m)} the sensor noise",
        why=f"The held-out error, {told(quality.held_out_rms_m, 'm')} rms, is "
        f"{_times(quality.held_out_rms_m, quality.noise_rms_m)} the sensor noise: something in "
        "the data is not in this model.",
        remedy="Repeat the same drive at three speeds a decade apart: what grows with speed is "
        "dynamics, what shrinks with it is creep or drift.",
    )


def _few_blocks(axis: AxisModel) -> Weakness | None:
    if axis.uncertainty.blocks >= FEW_BLOCKS:
        return None
    return Weakness(
        what=f"that its intervals rest on {axis.uncertainty.blocks} blocks of cycles",
        why=f"Every interval rests on {axis.uncertainty.blocks} blocks of cycles.",
        remedy="Record at least twelve cycles, of different sizes.",
    )


def _loose_loop(axis: AxisModel) -> Weakness | None:
    width_m, half_m = axis.uncertainty.loop_width_m
    if half_m <= LOOSE * abs(width_m):
        return None
    return Weakness(
        what=f"a loop width known to ± {told(half_m, 'm')} only",
        why=f"The loop's width is known to ± {told(half_m, 'm')} only, of {told(width_m, 'm')}.",
        remedy="Record full-range cycles in both directions, several times, at one speed.",
    )


def _sensor_limits(axis: AxisModel) -> Weakness | None:
    quality = axis.quality
    if quality.held_out_rms_m > NEAR_NOISE * quality.noise_rms_m:
        return None
    return Weakness(
        what="the sensor, which sees no more",
        why="The held-out error is within twice the sensor noise: this sensor sees no more.",
        remedy="Nothing is needed; a quieter sensor or averaging would show what is left.",
    )


def _times(value: float, reference: float) -> str:
    return f"{value / reference:.1f} times" if reference > 0.0 else "far above"


RULES: tuple[Rule, ...] = (
    _class_does_not_apply,
    _one_excitation,
    _few_blocks,
    _loose_loop,
    _far_from_noise,
    _wandering_zero,
    _not_converged,
    _sensor_limits,
)
