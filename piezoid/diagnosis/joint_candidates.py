"""Pairs: two effects that look alike, found at once because one alone is taken for both.

A lag fitted to a lag and a rate dependence follows most of the two, and what it leaves is nobody's
tangent; or it has a time of its own in every recording and is refused. So the two are refined
together from where each came alone, and each has to be worth its place beside the other as that
came alone.
"""

from collections.abc import Iterable, Sequence
from functools import partial

from piezoid.diagnosis.candidate import CERTAIN, Candidate, asked, judged
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.folds import compared
from piezoid.diagnosis.refinement import Refined, initial_guess, refined, refined_together
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.shortlist import SelectionContext
from piezoid.diagnosis.view import View
from piezoid.numerics.executor import SERIAL, Executor

MUCH = 0.4  # of the error: what one of the two takes off where it stands for both
SURE = 4.0  # standard errors: one cause for what two would explain is the simpler tale
LEAST = 0.01  # of the error: what a round of both must gain to be gone on with
ROUNDS = 2  # along their valley; the rest of the way is gone when confounded effects are asked
NOISY = 1.1  # times the noise: an error below it leaves nothing for a second effect
WIDE = 2  # parameters: what has fewer is refined beside what was selected whenever it is tried
Pair = tuple[Sequence[SelectedEffect], View]


def pair_of(
    tried: Sequence[Candidate], beside: SelectionContext, executor: Executor = SERIAL
) -> tuple[SelectedEffect, ...]:
    """Return two effects of which neither was possible alone, none where they are no evidence.

    tried  effects refitted alone beside what was selected
    """
    one = min(tried, key=lambda j: j.view.rms, default=None)
    if one is None or one.physical or one.cv.gain < MUCH or one.cv.z < CERTAIN:
        return ()
    alike = [j for j in tried if j is not one and _alike(j.effect, one.effect)]
    alone = (one.selected, one.view)
    others = [(j.selected, j.view) for j in alike]
    return _best(
        executor.map(lambda other: _pair(alone, other, beside.clean, beside.selected), others)
    )


def pair_in_place(
    beside: SelectionContext, executor: Executor = SERIAL
) -> tuple[SelectedEffect, ...]:
    """Return what was selected with two effects in the place of one, none where that is no better.

    Looked for is one of more parameters than the time of what was selected.
    """
    if beside.view.rms < NOISY * beside.view.noise:
        return ()
    named = {one.effect.name for one in beside.selected}
    for one in beside.selected:
        if not one.free or one.from_jumps:
            continue
        rest = tuple(other for other in beside.selected if other is not one)
        alike = [e for e in EFFECTS if e.name not in named and _alike(e, one.effect)]
        without = extended(beside.clean, rest)
        here = (one, beside.view)
        best = _best(executor.map(partial(_beside, here, without, beside.clean, rest), alike))
        if best:
            return (*rest, *best)
    return ()


def _alike(effect: Effect, other: Effect) -> bool:
    """Tell whether one may be taken for both; what rings is nowhere taken for a lag."""
    return effect.null_without is None and not effect.may_be_absorbed and effect.resembles(other)


def _beside(
    here: Refined, without: View, clean: View, rest: Sequence[SelectedEffect], effect: Effect
) -> Pair | None:
    other = _alone(effect, without, clean, rest)
    return _pair(here, other, clean, rest) if other else None


def _alone(
    effect: Effect, without: View, clean: View, rest: Sequence[SelectedEffect]
) -> Refined | None:
    """Return an effect refined in the place of another, None where it cannot be or is narrow.

    without  the view with the rest at work
    """
    if effect.untestable(without):
        return None
    seen = score_test(effect, without)
    if seen is None or not seen.physical or len(seen.trial.free) < WIDE:
        return None
    return refined(initial_guess(effect, seen.trial, float(seen.cv.coefficient[0])), clean, rest)


def _best(pairs: Iterable[Pair | None]) -> tuple[SelectedEffect, ...]:
    found = [pair for pair in pairs if pair is not None]
    best = min(found, key=lambda pair: pair[1].rms, default=((), None))
    return tuple(best[0])


def _pair(
    one: Refined, other: Refined, clean: View, rest: Sequence[SelectedEffect]
) -> Pair | None:
    """Return both and the view with them, None where one alone does as well or is impossible."""
    two = [one[0], other[0]]
    alone = min(one[1], other[1], key=lambda view: view.rms)
    for _ in range(ROUNDS):
        two, view = refined_together(two, clean, rest)
        if view.rms > (1.0 - LEAST) * alone.rms:
            return None
    withouts = [extended(clean, [*rest, each]) for each in reversed(two)]
    needed = zip(two, withouts, (other[1], one[1]), strict=True)
    return (two, view) if all(_is_needed(*each, view) for each in needed) else None


def _is_needed(one: SelectedEffect, without: View, single: View, view: View) -> bool:
    """Tell whether one of two is evidence beside the other, and beside the other as it was alone.

    without  the view with the other as it is now
    single   the view with the other as it was alone
    """
    seen = score_test(one.effect, without)
    if seen is None or not judged(one, view, without, seen=seen).is_significant:
        return False
    held = compared(single.null, view.null)
    return held.z > SURE and held.gain > one.effect.minimum_gain * asked(single)
