"""Candidates: the effects of one round that are refitted, and the one that leaves least.

Tangents tell which to refit: those that bring a good part of the best, and where none of them is
evidence all others that bring anything.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from piezoid.diagnosis.candidate import Candidate, judged
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.refinement import initial_guess, refined, refined_together
from piezoid.diagnosis.score_test import ScoreTest
from piezoid.diagnosis.view import View
from piezoid.numerics.executor import Executor

TELLING = 0.25  # of the best tangent's gain, from which an effect is refitted at first
LEAST_GAIN = 0.012  # of the error: tangents err by factors
NEAR_PLACEBO = 0.9  # times its placebo's gain, below which a refit will not help it
NEAR = 3.0  # times the least error left: how far a first refit may lie behind to be refined


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionContext:
    """What candidates are refitted beside.

    clean     the view without any effect
    selected  effects that are at work already
    view      the view with them
    """

    clean: View
    selected: tuple[SelectedEffect, ...]
    view: View


def refit_shortlist(
    found: Iterable[ScoreTest], beside: SelectionContext, executor: Executor
) -> list[Candidate]:
    """Return the telling effects with everything refitted, and if none is evidence the others."""
    hopeful = [f for f in found if f.physical and f.total_gain > LEAST_GAIN]
    telling = TELLING * max((f.total_gain for f in hopeful), default=0.0)
    hopeful = [f for f in hopeful if _above_placebo(f)]
    tried = _refined([f for f in hopeful if f.total_gain > telling], beside, executor)
    if best_candidate(tried) is None:
        tried += _refined([f for f in hopeful if f.total_gain <= telling], beside, executor)
    return tried


def best_candidate(tried: Sequence[Candidate]) -> Candidate | None:
    """Return the effect that leaves least among those that are evidence."""
    own = [j for j in tried if j.is_significant]
    return min(own, key=lambda j: j.cv.rms, default=None)


def _refined(
    telling: Sequence[ScoreTest], beside: SelectionContext, executor: Executor
) -> list[Candidate]:
    """Return effects with everything refitted, but those that begin far behind the best."""
    first = [initial_guess(f.effect, f.trial, float(f.cv.coefficient[0])) for f in telling]
    left = executor.map(lambda one: extended(beside.clean, [*beside.selected, one]).rms, first)
    least = min(left, default=0.0)

    def refit(begin: tuple[SelectedEffect, ScoreTest]) -> Candidate:
        one, found = begin
        executor.report(f"refitting with {one.effect.name.replace('_', ' ')}")
        better, view = refined(one, beside.clean, beside.selected)
        return _refined_together(judged(better, view, beside.view, seen=found), beside, found)

    near = [
        (one, found)
        for one, found, rms in zip(first, telling, left, strict=True)
        if rms <= NEAR * least
    ]
    return executor.map(refit, near)


def _refined_together(alone: Candidate, beside: SelectionContext, seen: ScoreTest) -> Candidate:
    """Refine what was selected alone for both, where these look alike, and the effect again.

    A delay that is none may be one then: beside a limit that follows a part of it, it differs from
    recording to recording. Where more is free than a time, that costs too much to hope for.
    """
    free = len(alone.selected.free)
    moving = [one for one in beside.selected if one.free and not one.from_jumps]
    alike = [one for one in moving if one.effect.resembles(alone.effect)]
    if not alike or not (free == 1 or (free and alone.physical)):
        return alone
    others = [one for one in beside.selected if one not in alike]
    better, view = refined_together([*alike, alone.selected], beside.clean, others)
    return judged(better[-1], view, alone.without, seen=seen)


def _above_placebo(found: ScoreTest) -> bool:
    """Tell whether a refit may help: tangents of what is looked for on a grid err by factors."""
    if found.placebo is None or found.trial.free:
        return True
    return found.cv.gain > NEAR_PLACEBO * found.placebo.gain
