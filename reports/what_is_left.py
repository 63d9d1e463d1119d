"""What a diagnosis says of an error that is left: causes already taken out, what to do next.

One voice for the verdict, the cards and the last chapter: where a diagnosis names causes, theirs
is the next experiment, and no other is proposed beside it.
"""

from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.at_rest import RESTS
from piezoid.diagnosis.diagnosis import Diagnosis, Finding, Unexplained
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.something_else import NAME
from piezoid.diagnosis.unnamed import words as place_words
from piezoid.formatting import with_unit, words
from piezoid.identification.model import AxisModel

CHANCE = 0.05  # p-value: what more healthy stages leave is told to be usual
LEAST = 0.01  # part of the power: less is told as living nowhere

SPEEDS = (
    "Repeat the same drive at three speeds a decade apart: what grows with speed is dynamics, "
    "what shrinks with it is creep or drift."
)
MOST = 0.5  # of the power of an error: from there on it is said to be that
OTHER_SHAPE = (
    "No recording of this kind lowers it: feedback takes it up, which bound and certificate count."
)
SHAPE = (
    "Record reversals of many sizes at several biases, each reached from above and from below: "
    "what then still is no cause is loops of a shape that plays and dead zones do not have, and "
    "only feedback takes those up."
)


@dataclass(frozen=True, kw_only=True)
class Left:
    """What is said of an error far above the noise.

    short   to follow "an error so many times the sensor noise"
    why     to end a sentence that gives its size, with its full stop
    remedy  the next experiment, in whole sentences
    """

    short: str
    why: str
    remedy: str


@dataclass(frozen=True, kw_only=True)
class Mover:
    """A cause that moves a zero, and the experiment that shows it."""

    name: str
    experiment: str


def left_of(found: Diagnosis | None, axis: AxisModel | None = None) -> Left:
    """Return what a diagnosis, or the lack of one, says of an error far above the noise.

    axis  of whose fit the error is, for what its recordings can show; None: nothing more is said
    """
    if found is None:
        return Left(short="", why=": something in the data is not in this model.", remedy=SPEEDS)
    shape = shape_lacked(found, axis)
    if not found.findings and shape:
        return Left(
            short=", which lies in the shape of its loops",
            why=f", and its cause is the class of the model: {shape}.",
            remedy=OTHER_SHAPE,
        )
    if not found.findings:
        return Left(
            short=", for which the diagnosis finds no cause",
            why=", and the diagnosis finds no cause for it.",
            remedy=SHAPE,
        )
    # what cannot be told apart comes first, then the largest
    leading = next((one for one in found.findings if one.not_separable_from), found.findings[0])
    rest = f"; {shape or 'no other cause is visible in what is left'}"
    rest = _or_rival(leading) or rest
    most = "; most of it lies in the shape of its loops" if shape else ""
    return Left(
        short=f", with {named(found)} already taken out{_or_rival(leading) or most}",
        why=f", with {named(found)}, as the diagnosis finds, already taken out{rest}.",
        remedy=leading.next_experiment,
    )


def shape_lacked(found: Diagnosis, axis: AxisModel | None) -> str:
    """Say of a simulation how much of its error a wider class of hysteresis does not make.

    Empty where that class, on the same blocks left out, leaves as much of the power itself; where
    a zero moves by as much as lies between, which a wide class follows as if it were a loop; and
    where speed, size or repetition were never varied, or the class does not apply: then it
    imitates a lag, or whatever else the recordings do not tell from a loop.
    """
    left_m, wide_m = found.final.rms_m, found.envelope_rms_m
    if axis is None or not axis.verdict.applies or axis.quality.limits:
        return ""
    if not wide_m**2 < (1.0 - MOST) * left_m**2:
        return ""
    if _moved_zero_m2(axis) > MOST * (left_m**2 - wide_m**2):
        return ""
    return (
        f"where the simulation leaves {with_unit(left_m, 'm')}, the widest class of hysteresis "
        f"leaves {with_unit(wide_m, 'm')}; between them lie loops of a shape that plays and dead "
        "zones do not have"
    )


def _moved_zero_m2(axis: AxisModel) -> float:
    """Return the power of what zeros do during recordings, straight between their knots, m^2."""
    moved_m2 = []
    for start in axis.starts:
        first_m, last_m = start.zero_m[:-1], start.zero_m[1:]
        if not len(first_m):
            moved_m2.append(0.0)
            continue
        mean_m = float(np.mean(first_m + last_m)) / 2.0
        square_m2 = float(np.mean(first_m**2 + first_m * last_m + last_m**2)) / 3.0
        moved_m2.append(square_m2 - mean_m**2)
    return sum(moved_m2) / max(len(moved_m2), 1)


def largest_first(found: Diagnosis) -> tuple[Finding, ...]:
    """Return the findings, what has no name in front where it is larger than all that have one."""
    unnamed = [one for one in found.findings if one.effect == NAME]
    others = [one for one in found.findings if one.effect != NAME]
    if all(one.share > other.share for one in unnamed for other in others):
        return (*unnamed, *others)
    return found.findings


def nothing_named(found: Diagnosis) -> str:
    """Say of a diagnosis without findings what was tested, what is left and where it lives."""
    tested = sum(one.upper_bound_m is not None for one in found.not_detected)
    if not tested:
        reasons = {one.reason for one in found.not_detected}
        why = f": {reasons.pop().rstrip('.')}" if len(reasons) == 1 else ""
        return f"No cause could be tested{why}."
    left_m, noise_m = found.envelope_rms_m, found.noise_floor_rms_m
    times = f", {left_m / noise_m:.2g} times the sensor's noise," if noise_m > 0.0 else ""
    where = ""
    if found.unexplained is not None:
        where = f" {_lives(found.unexplained)}"
    count = "1 effect was" if tested == 1 else f"{tested} effects were"
    rests = any(one.reason == RESTS for one in found.not_detected)
    beside = "with the drive at rest" if rests else "beside hysteresis of any shape"
    return (
        f"{count} tested, and none is seen: {beside} {with_unit(left_m, 'm')} rms are left{times}"
        f"{where}."
    )


def _lives(rest: Unexplained) -> str:
    if rest.gain < LEAST:
        return "and they live in no coordinate"
    lives = f"and {100 * rest.gain:.2g} % of their power live in {place_words(rest.coordinate)}"
    if rest.p_value <= CHANCE:
        return lives
    return f"{lives}, as in {100 * rest.p_value:.0f} % of healthy stages"


def mover_of(found: Diagnosis | None) -> Mover | None:
    """Return the largest cause found that moves a zero, or None."""
    named = () if found is None else (one for one in found.findings if one.effect != NAME)
    slow = next((one for one in named if effect_named(one.effect).moves_zero), None)
    if slow is None:
        return None
    return Mover(name=words(slow.effect), experiment=slow.next_experiment)


def named(found: Diagnosis) -> str:
    """Return the causes found as a reader says them, the largest first."""
    *others, last = map(words, found.names)
    return f"{', '.join(others)} and {last}" if others else last


def _or_rival(finding: Finding) -> str:
    rivals = " or ".join(map(words, finding.not_separable_from))
    return f" ({words(finding.effect)} could be {rivals})" if rivals else ""
