"""Forward selection: one effect after another is added to those selected before.

Every step all effects get a score test. Tangents tell which to refit: those that bring a good part
of the best, and where none of them is evidence all others that bring anything. The shortlist is
refitted with the whole model, and the effect that leaves the smallest error is selected, unless
other initial states or a Bouc-Wen state leave less.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.bouc_wen_search import with_best_bouc_wen
from piezoid.diagnosis.candidate import Candidate, judged
from piezoid.diagnosis.effect import BETWEEN, Effect, Fault
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    InitialStates,
    with_own_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.refinement import initial_guess, refined, refined_together, stepped
from piezoid.diagnosis.refitted_view import SelectedEffect, extended
from piezoid.diagnosis.residual_view import (
    View,
    with_bouc_wen,
    with_free_memory,
    with_reversals,
)
from piezoid.diagnosis.sample_slips import slips_in_place
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.diagnosis.step_responses import modes_behind_jumps
from piezoid.formatting import words
from piezoid.numerics.executor import Executor

TELLING = 0.25  # of the best tangent's gain, from which an effect is refitted at first
LEAST_GAIN = 0.012  # of the error: tangents err by factors
NEAR_PLACEBO = 0.9  # times its placebo's gain, below which a refit will not help it
NEAR = 3.0  # times the least error left: how far a first refit may lie behind to be refined
ABOUT = (-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6)  # steps from a trial to beyond the next
CLEARLY = 0.98  # of the error that another place leaves, or another effect beside it
MOST_CAUSES = 5
SLIP = "timestamp_fault"
NOISY = 1.1  # residual/noise below which no structure of hysteresis is looked for
BOUC_WEN = 0.97  # largest relative error at which a Bouc-Wen state is taken in


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
    first = executor.map(lambda found: _beginning(found, beside), telling)
    left = executor.map(lambda one: extended(beside.clean, [*beside.selected, one]).rms, first)
    least = min(left, default=0.0)

    def refit(begin: tuple[SelectedEffect, ScoreTest]) -> Candidate:
        one, found = begin
        executor.report(f"refitting with {words(one.effect.name)}")
        better, view = refined(one, beside.clean, beside.selected)
        return _refined_together(judged(better, view, beside.view, seen=found), beside, found)

    near = [
        (one, found)
        for one, found, rms in zip(first, telling, left, strict=True)
        if rms <= NEAR * least
    ]
    return executor.map(refit, near)


def _beginning(found: ScoreTest, beside: SelectionContext) -> SelectedEffect:
    """Return where a refit begins: at the best tangent, or in front of the hysteresis at the best.

    A static response fitted to the command follows a part of what the stage was never given: its
    tangents lead astray, and the error has a second lowest place where the response makes up for
    the wrong limit. So there each trial is put in place, and each step about the best of them.
    """
    guess = initial_guess(found.effect, found.trial, float(found.cv.coefficient[0]))
    if found.effect.drive_filter is None or found.effect.trials is None:
        return guess

    def left(one: SelectedEffect) -> float:
        return extended(beside.clean, [*beside.selected, one]).rms

    trials = [trial for trial in found.effect.trials(beside.view) if trial.physical]
    best = min((guess, *(initial_guess(found.effect, trial, 1.0) for trial in trials)), key=left)
    near = [stepped(best, name, part) for name in best.free for part in ABOUT]
    return min((best, *near), key=left)


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


def moved_to_other_side(
    beside: SelectionContext, best: Candidate | None
) -> tuple[SelectedEffect, ...] | None:
    """Return what was selected with one on the other side of the hysteresis, where it fits better.

    An amplifier that charges the ceramic slowly rounds the turns of the drive before walls see
    them, a sensor's filter those of what walls have done. What the one leaves of the other looks
    like walls that need time.

    best  what else is evidence: asked is for one that looks like it, or for any where nothing is
    """
    for k, one in enumerate(beside.selected):
        other = one.effect.other_side
        if other is None or not (best is None or one.effect.resembles(best.effect)):
            continue
        rest = [*beside.selected[:k], *beside.selected[k + 1 :]]
        there, view = refined(replace(one, effect=other), beside.clean, rest, finer=1)
        if view.rms < CLEARLY * min(beside.view.rms, best.view.rms if best else beside.view.rms):
            return (*beside.selected[:k], there, *beside.selected[k + 1 :])
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionState:
    """The state of the selection after a step.

    clean     the view of repaired tracks, with the initial states and Bouc-Wen state taken in
    selected  effects, in the order in which they were selected
    faults    of the data, by effect
    screened  the last score test of each effect that was not selected, also ``BETWEEN`` recordings
    initial   the best shared and the best own initial states, where they are known
    """

    clean: View
    selected: tuple[SelectedEffect, ...]
    faults: Mapping[str, Fault]
    screened: Mapping[str, ScoreTest]
    initial: InitialStates | None = None


def select_forward(
    clean: View,
    faults: Mapping[str, Fault],
    executor: Executor,
    initial: InitialStates | None = None,
) -> SelectionState:
    """Select one effect after another until none is evidence.

    initial  of the view, where they are known
    """
    executor.report("looking for modes after steps of the drive")
    selected = modes_behind_jumps(clean)
    state = SelectionState(
        clean=clean,
        selected=selected,
        faults=faults,
        screened={},
        initial=None if selected else initial,
    )
    for _ in range(MOST_CAUSES + 2):
        view = extended(state.clean, state.selected)
        named = {one.effect.name for one in state.selected}
        state = replace(state, screened=_score_all(view, named, executor))
        next_state = _next_state(state, view, executor)
        if next_state is None:
            break
        state = next_state
    return state


def _next_state(state: SelectionState, view: View, executor: Executor) -> SelectionState | None:
    """Return the state after the step that leaves the smallest error; None where none helps.

    A step takes in a Bouc-Wen state, other initial states or an effect.

    view  with everything selected, on which the score tests were made
    """

    def bend() -> View:
        return with_best_bouc_wen(view) if view.rms > NOISY * view.noise else view

    beside = SelectionContext(clean=state.clean, selected=state.selected, view=view)
    tried = refit_shortlist(state.screened.values(), beside, executor)
    best = best_candidate(tried)
    least = best.view.rms if best else np.inf
    moved = moved_to_other_side(beside, best)
    if moved is not None:
        return replace(state, selected=moved, initial=None)
    if state.initial is None:
        shared = with_shared_initial_state(view, executor)
        own, bent = executor.both(lambda: with_own_initial_states(view, shared), bend)
    else:
        (shared, own), bent = state.initial, bend()
    if bent.rms < min(BOUC_WEN * view.rms, least, own.rms):
        clean = with_bouc_wen(state.clean, bent.nuisance.bouc_wen)
        return replace(state, clean=clean, initial=None)
    if leaves_clearly_less(own, view, least):
        # beside selected effects they are not the same again: these follow the static response
        return replace(
            state,
            clean=with_free_memory(with_reversals(state.clean, own.nuisance.reversals)),
            initial=None if state.selected else (shared, own),
        )
    if best is None:
        return _with_slips_in_place(state, view)
    return replace(state, selected=(*state.selected, best.selected), initial=None)


def leaves_clearly_less(own: View, view: View, least: float) -> bool:
    """Tell whether a view with other initial states is taken; ``least``: what an effect leaves."""
    return own.rms < min(OTHER_INITIAL_STATES * view.rms, least)


def _with_slips_in_place(state: SelectionState, view: View) -> SelectionState | None:
    """Take in slips that stand better than a filter selected before, in its place."""
    known = state.faults.get(SLIP)
    if known is None:
        return None
    for one in state.selected:
        if one.effect.response_filter is None:
            continue
        rest = tuple(other for other in state.selected if other is not one)
        slips = slips_in_place(state.clean, rest, view, known)
        if slips is not None:
            faults = {**state.faults, SLIP: slips[1].after(known)}
            return replace(state, clean=slips[0], selected=rest, faults=faults, initial=None)
    return None


def _score_all(view: View, named: set[str], executor: Executor) -> dict[str, ScoreTest]:
    def screened(effect: Effect) -> ScoreTest | None:
        executor.report(f"testing {words(effect.name)}")
        return score_test(effect, view)

    others = [e for e in every_effect() if e.structural is None and e.name not in named]
    others = [effect for effect in others if not effect.untestable(view)]
    between = {
        f"{e.name} {BETWEEN}": e.between_recordings
        for e in others
        if e.between_recordings is not None
    }
    asked = {**{effect.name: effect for effect in others}, **between}
    found = zip(asked, executor.map(screened, asked.values()), strict=True)
    return {name: one for name, one in found if one is not None}
