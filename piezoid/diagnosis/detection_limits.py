"""Absence: how large an effect may be that was not named, and the size that would have shown."""

from math import sqrt

from piezoid.diagnosis.candidate import MINIMUM_SHARE, MINIMUM_Z, exceeds_structure
from piezoid.diagnosis.diagnosis import NotDetected
from piezoid.diagnosis.effect import BETWEEN, Effect
from piezoid.diagnosis.score_test import ScoreTest
from piezoid.diagnosis.selection import Outcome
from piezoid.formatting import with_unit, words

SPEEDS = (
    "Record the same loops at half the speed or less as well: what needs time shrinks with speed, "
    "hysteresis stays."
)
POWER = 2.8 / 1.645  # bound for one-sided 95 % to limit for four cases of five


def absent(effect: Effect, outcome: Outcome) -> NotDetected:
    """Return what is known of an effect that is not among the causes."""
    found = _sought(effect, outcome)
    untestable = effect.untestable(outcome.final)
    width = "" if found is None or found.separable or untestable else _width(effect, outcome)
    if found is not None and not untestable and not width:
        return _bounded(found, outcome)
    if untestable or width or effect.fault is None:
        return NotDetected(
            effect=effect.name,
            upper_bound_m=None,
            detection_limit_m=None,
            reason=untestable or width or "nothing in these recordings excites it",
            next_experiment=SPEEDS if width else effect.experiment,
        )
    limit_m = effect.fault.bound(outcome.clean) * 2.0 * outcome.final.stroke_m
    return NotDetected(
        effect=effect.name,
        upper_bound_m=limit_m,
        detection_limit_m=limit_m,
        reason=f"not detected; {with_unit(limit_m, 'm')} would have been",
        next_experiment=effect.experiment,
    )


def not_sought(effect: Effect, against: str) -> NotDetected:
    """Say of an effect that it was not tested, because the model class does not apply."""
    return NotDetected(
        effect=effect.name,
        upper_bound_m=None,
        detection_limit_m=None,
        reason=f"not tested, because the model class does not apply: {against}",
        next_experiment=effect.experiment,
    )


def _sought(effect: Effect, outcome: Outcome) -> ScoreTest | None:
    """Return where the effect was sought: of two ways, the one in which more may be hidden."""
    ways = (effect.name, f"{effect.name} {BETWEEN}")
    sought = [outcome.screened[way] for way in ways if way in outcome.screened]
    return max(sought, key=lambda one: one.absorption * one.bound, default=None)


def _width(effect: Effect, outcome: Outcome) -> str:
    """Say what an effect is not separable from where the drive has one speed."""
    alike = [
        words(name)
        for name, found in outcome.screened.items()
        if name in effect.confounded and not found.separable
    ]
    return (
        f"not separable from hysteresis{''.join(f', {name}' for name in alike)}: like branches "
        "were all driven at one speed, and there each is a width of the loop"
    )


def _bounded(found: ScoreTest, outcome: Outcome) -> NotDetected:
    # what hysteresis takes up is there all the same
    across_m = found.absorption * 2.0 * outcome.final.stroke_m
    doubt = found.bound - found.share
    needed = outcome.final.rms / 2.0 * sqrt(2.0 * found.effect.minimum_gain)
    bound_m = across_m * found.bound
    # what may be there and was not named has not shown either
    limit_m = max(across_m * max(POWER * doubt, needed, MINIMUM_SHARE, found.floor), bound_m)
    return NotDetected(
        effect=found.effect.name,
        upper_bound_m=bound_m,
        detection_limit_m=limit_m,
        reason=(
            f"at most {with_unit(bound_m, 'm')} rms; it reduces the held-out error by "
            f"{100 * found.cv.gain:.2g} % ({found.cv.z:.2g} standard errors)"
            f"{_beside_placebo(found)}"
            f"{_held_back(found, outcome) or _in_spite_of(found, outcome)}"
        ),
        next_experiment=found.effect.experiment,
    )


def _beside_placebo(found: ScoreTest) -> str:
    if found.placebo is None:
        return ""
    return f", its placebo {100 * found.placebo.gain:.2g} %"


def _in_spite_of(found: ScoreTest, outcome: Outcome) -> str:
    """Say why what seems to be evidence by itself was not named."""
    if found.cv.gain < found.effect.minimum_gain or found.cv.z < MINIMUM_Z:
        return ""
    if not found.physical:
        return ": not named, because this size is physically impossible"
    if not exceeds_structure(found.share, outcome.final.rms, outcome.final.noise):
        return ": not named, because structure that no hysteresis class explains is as large"
    causes = ", ".join(words(cause.effect.name) for cause in outcome.causes)
    rest = f", or it is a residue of {causes}" if causes else ""
    return f": not named, because it is not significant beside the other effects{rest}"


def _held_back(found: ScoreTest, outcome: Outcome) -> str:
    if found.effect.name not in outcome.held_back:
        return ""
    causes = ", ".join(words(cause.effect.name) for cause in outcome.causes)
    beside = f"a residue of {causes}" if causes else "structure that no hysteresis class explains"
    return f": not named, because these recordings cannot separate it from {beside}"
