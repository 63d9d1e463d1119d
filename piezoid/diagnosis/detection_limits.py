"""Effects that were not detected: an upper bound and a detection limit for each."""

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
POWER = 2.8 / 1.645  # limit for four cases in five, in units of a one-sided 95 % bound


def not_detected(effect: Effect, outcome: Outcome) -> NotDetected:
    """Return the upper bound and the detection limit of an effect that was not selected."""
    test, untestable = _last_test(effect, outcome), effect.untestable(outcome.final)
    if untestable:
        return _untested(effect, untestable, effect.experiment)
    if test is not None and not test.separable:
        return _untested(effect, _inseparable_reason(effect, outcome), SPEEDS)
    if test is not None:
        return _bounded(test, outcome)
    if effect.fault is None:
        return _untested(effect, "nothing in these recordings excites it", effect.experiment)
    limit_m = effect.fault.bound(outcome.clean) * 2.0 * outcome.final.half_stroke_m
    return NotDetected(
        effect=effect.name,
        upper_bound_m=limit_m,
        detection_limit_m=limit_m,
        reason=f"not detected; {with_unit(limit_m, 'm')} would have been",
        next_experiment=effect.experiment,
    )


def not_tested(effect: Effect, rejection: str) -> NotDetected:
    """State that an effect was not tested because the model class does not apply."""
    reason = f"not tested, because the model class does not apply: {rejection}"
    return _untested(effect, reason, effect.experiment)


def _untested(effect: Effect, reason: str, next_experiment: str) -> NotDetected:
    return NotDetected(
        effect=effect.name,
        upper_bound_m=None,
        detection_limit_m=None,
        reason=reason,
        next_experiment=next_experiment,
    )


def _last_test(effect: Effect, outcome: Outcome) -> ScoreTest | None:
    """Return the last score test within or between recordings, whichever has the larger bound."""
    names = (effect.name, f"{effect.name} {BETWEEN}")
    tests = [outcome.score_tests[name] for name in names if name in outcome.score_tests]
    return max(tests, key=lambda test: test.absorption * test.bound, default=None)


def _inseparable_reason(effect: Effect, outcome: Outcome) -> str:
    confounded = [
        words(name)
        for name, test in outcome.score_tests.items()
        if name in effect.confounded and not test.separable
    ]
    return (
        f"not separable from {', '.join(('hysteresis', *confounded))}: like branches "
        "were all driven at one speed, and there each is a width of the loop"
    )


def _bounded(test: ScoreTest, outcome: Outcome) -> NotDetected:
    """Return the bounds of a tested effect, including the part that hysteresis absorbs.

    The detection limit is at least the bound: an effect of that size may be present and was not
    named. A bound above the range is none.
    """
    effect, final = test.effect, outcome.final
    scale_m = test.absorption * 2.0 * final.half_stroke_m
    bound_m = scale_m * test.bound
    if bound_m > 2.0 * final.half_stroke_m:
        reason = "hysteresis absorbs it on these recordings: any size up to the range would fit"
        return _untested(effect, reason, effect.experiment)
    min_share = final.rms / 2.0 * sqrt(2.0 * effect.minimum_gain)
    margin = POWER * (test.bound - test.share)
    limit_m = max(scale_m * max(margin, min_share, MINIMUM_SHARE, test.floor), bound_m)
    placebo = "" if test.placebo is None else f", its placebo {100 * test.placebo.gain:.2g} %"
    return NotDetected(
        effect=effect.name,
        upper_bound_m=bound_m,
        detection_limit_m=limit_m,
        reason=(
            f"at most {with_unit(bound_m, 'm')} rms; it reduces the held-out error by "
            f"{100 * test.cv.gain:.2g} % ({test.cv.z:.2g} standard errors)"
            f"{placebo}{_why_not_named(test, outcome)}"
        ),
        next_experiment=effect.experiment,
    )


def _why_not_named(test: ScoreTest, outcome: Outcome) -> str:
    """State why an effect was not named although its score test alone is significant."""
    effect, final = test.effect, outcome.final
    causes = ", ".join(words(cause.effect.name) for cause in outcome.causes)
    if effect.name in outcome.inseparable:
        alternative = (
            f"a residue of {causes}" if causes else "structure that no hysteresis class explains"
        )
        return f": not named, because these recordings cannot separate it from {alternative}"
    if any(cause.effect.name == effect.name for cause in outcome.doubtful):
        return ": not named, because the model predicts left-out data about as well without it"
    if test.cv.gain < effect.minimum_gain or test.cv.z < MINIMUM_Z:
        return ""
    if not test.physical:
        return ": not named, because this size is physically impossible"
    if not exceeds_structure(test.share, final.rms, final.noise):
        return ": not named, because structure that no hysteresis class explains is as large"
    residue = f", or it is a residue of {causes}" if causes else ""
    return f": not named, because it is not significant beside the other effects{residue}"
