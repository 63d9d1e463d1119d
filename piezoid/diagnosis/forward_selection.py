"""Forward selection: take in one effect after another until none is significant.

A step takes in the effect that leaves the smallest error, or what explains as much without any
effect: a filter on the other side of the hysteresis, a Bouc-Wen state, other initial states. Where
nothing is significant, slips of the clock are tried in the place of a filter.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from piezoid.diagnosis.bouc_wen_search import with_best_bouc_wen
from piezoid.diagnosis.candidate import Candidate, evaluate
from piezoid.diagnosis.effect import BETWEEN, Effect, Fault
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.effects.timestamp_fault import find_slips_beside
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    InitialStates,
    with_own_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.refinement import initial_guess, refine, refine_together, with_step
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import (
    View,
    with_bouc_wen,
    with_free_memory,
    with_reversals,
    with_tracks,
)
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.step_responses import modes_behind_jumps
from piezoid.formatting import words
from piezoid.numerics.executor import Executor

FIRST_GAIN = 0.25  # of the best tangent's gain, from which an effect is refitted at first
MIN_GAIN = 0.012  # of the error: tangents err by factors
NEAR_PLACEBO = 0.9  # times its placebo's gain, below which a refit will not help it
NEAR = 3.0  # times the least error left: how far a first refit may lie behind to be refined
ABOUT = (-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6)  # steps from a trial to beyond the next
OTHER_SIDE = 0.98  # largest relative error at which a filter changes its side
MAX_EFFECTS = 5
SLIP = "timestamp_fault"
NOISY = 1.1  # residual/noise below which no structure of hysteresis is looked for
BOUC_WEN = 0.97  # largest relative error at which a Bouc-Wen state is taken in


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionState:
    """The state of the selection after a step.

    clean     the view of repaired tracks, with the initial states and Bouc-Wen state taken in
    selected  effects, in the order in which they were selected
    view      the view with them, on which the score tests are made
    faults    of the data, by effect
    screened  the last score test of each effect that was not selected, also ``BETWEEN`` recordings
    initial   the best shared and the best own initial states, where they are known
    """

    clean: View
    selected: tuple[SelectedEffect, ...]
    view: View
    faults: Mapping[str, Fault]
    screened: Mapping[str, ScoreTest]
    initial: InitialStates | None = None

    def after(
        self,
        *,
        clean: View | None = None,
        selected: Sequence[SelectedEffect] | None = None,
        faults: Mapping[str, Fault] | None = None,
        initial: InitialStates | None = None,
    ) -> "SelectionState":
        """Return the state after a step that changes these."""
        clean = self.clean if clean is None else clean
        selected = self.selected if selected is None else tuple(selected)
        return SelectionState(
            clean=clean,
            selected=selected,
            view=with_effects(clean, selected),
            faults=self.faults if faults is None else faults,
            screened=self.screened,
            initial=initial,
        )


def select_forward(
    clean: View,
    faults: Mapping[str, Fault],
    executor: Executor,
    initial: InitialStates | None = None,
) -> SelectionState:
    """Select one effect after another until none is significant.

    initial  of the view, where they are known
    """
    executor.report("looking for modes after steps of the drive")
    selected = modes_behind_jumps(clean)
    state = SelectionState(
        clean=clean,
        selected=selected,
        view=with_effects(clean, selected),
        faults=faults,
        screened={},
        initial=None if selected else initial,
    )
    for _ in range(MAX_EFFECTS + 2):
        state = replace(state, screened=_score_all(state, executor))
        next_state = _next_state(state, executor)
        if next_state is None:
            break
        state = next_state
    return state


def _score_all(state: SelectionState, executor: Executor) -> dict[str, ScoreTest]:
    def tested(effect: Effect) -> ScoreTest | None:
        executor.report(f"testing {words(effect.name)}")
        return score_test(effect, state.view)

    named = {one.effect.name for one in state.selected}
    effects = {
        effect.name: effect
        for effect in every_effect()
        if effect.structural is None
        and effect.name not in named
        and not effect.untestable(state.view)
    }
    for name, effect in list(effects.items()):
        if effect.between_recordings is not None:
            effects[f"{name} {BETWEEN}"] = effect.between_recordings
    tests = zip(effects, executor.map(tested, effects.values()), strict=True)
    return {name: test for name, test in tests if test is not None}


def _next_state(state: SelectionState, executor: Executor) -> SelectionState | None:
    """Return the state after the step that leaves the smallest error; None where none helps."""
    view = state.view

    def with_bouc_wen_state() -> View:
        return with_best_bouc_wen(view) if view.rms > NOISY * view.noise else view

    best = best_candidate(refit_shortlist(state, executor))
    least = best.view.rms if best else np.inf
    moved = moved_to_other_side(state, best)
    if moved is not None:
        return state.after(selected=moved)
    if state.initial is None:
        shared = with_shared_initial_state(view, executor)
        own, bent = executor.both(
            lambda: with_own_initial_states(view, shared), with_bouc_wen_state
        )
    else:
        (shared, own), bent = state.initial, with_bouc_wen_state()
    if bent.rms < min(BOUC_WEN * view.rms, least, own.rms):
        return state.after(clean=with_bouc_wen(state.clean, bent.nuisance.bouc_wen))
    if initial_states_explain(own, view, least):
        # beside selected effects they are not the same again: these follow the static response
        return state.after(
            clean=with_free_memory(with_reversals(state.clean, own.nuisance.reversals)),
            initial=None if state.selected else (shared, own),
        )
    if best is None:
        return _with_slips(state)
    return state.after(selected=(*state.selected, best.selected))


def initial_states_explain(own: View, view: View, least: float) -> bool:
    """Return whether other initial states explain more than any effect, which leaves ``least``."""
    return own.rms < min(OTHER_INITIAL_STATES * view.rms, least)


def refit_shortlist(state: SelectionState, executor: Executor) -> list[Candidate]:
    """Return the best effects with everything refitted, and if none is significant the others.

    An effect goes on if its tangent explains enough, and as much as its placebo; tangents of
    parameters that are refined err by factors, and are not held against their placebos.
    """
    hopeful = [f for f in state.screened.values() if f.physical and f.total_gain > MIN_GAIN]
    first_gain = FIRST_GAIN * max((f.total_gain for f in hopeful), default=0.0)
    hopeful = [
        f
        for f in hopeful
        if f.placebo is None or f.trial.free or f.cv.gain > NEAR_PLACEBO * f.placebo.gain
    ]
    tried = _refitted([f for f in hopeful if f.total_gain > first_gain], state, executor)
    if best_candidate(tried) is None:
        tried += _refitted([f for f in hopeful if f.total_gain <= first_gain], state, executor)
    return tried


def best_candidate(tried: Iterable[Candidate]) -> Candidate | None:
    """Return the effect that leaves least among those that are significant."""
    significant = [candidate for candidate in tried if candidate.is_significant]
    return min(significant, key=lambda candidate: candidate.cv.rms, default=None)


def _refitted(
    tests: Sequence[ScoreTest], state: SelectionState, executor: Executor
) -> list[Candidate]:
    """Return effects with everything refitted, but those that begin far behind the best."""
    clean, selected = state.clean, state.selected
    starts = executor.map(lambda test: _start(test, state), tests)
    errors = executor.map(lambda start: with_effects(clean, [*selected, start]).rms, starts)
    least = min(errors, default=0.0)

    def refit(pair: tuple[SelectedEffect, ScoreTest]) -> Candidate:
        start, test = pair
        executor.report(f"refitting with {words(start.effect.name)}")
        better, view = refine(start, clean, selected)
        return _refitted_together(evaluate(better, view, state.view, test=test), state, test)

    near = [
        (start, test)
        for start, test, rms in zip(starts, tests, errors, strict=True)
        if rms <= NEAR * least
    ]
    return executor.map(refit, near)


def _start(test: ScoreTest, state: SelectionState) -> SelectedEffect:
    """Return where a refit begins: at the best tangent, or in front of the hysteresis at the best.

    A static response fitted to the command follows a part of what the stage was never given: its
    tangents lead astray, and the error has a second lowest place where the response makes up for
    the wrong limit. So there each trial is put in place, and each step about the best of them.
    """
    guess = initial_guess(test.effect, test.trial, float(test.cv.coefficient[0]))
    if test.effect.drive_filter is None or test.effect.trials is None:
        return guess

    def error(start: SelectedEffect) -> float:
        return with_effects(state.clean, [*state.selected, start]).rms

    trials = [trial for trial in test.effect.trials(state.view) if trial.physical]
    best = min((guess, *(initial_guess(test.effect, trial, 1.0) for trial in trials)), key=error)
    near = [with_step(best, name, part) for name in best.free for part in ABOUT]
    return min((best, *near), key=error)


def _refitted_together(alone: Candidate, state: SelectionState, test: ScoreTest) -> Candidate:
    """Refine selected effects that look like a candidate together with it.

    A delay that is none may be one then: beside a limit that follows a part of it, it differs from
    recording to recording. Where more is free than a time, that costs too much to hope for.
    """
    free = len(alone.selected.free)
    alike = [
        one
        for one in state.selected
        if one.free and not one.from_jumps and one.effect.resembles(alone.effect)
    ]
    if not alike or not (free == 1 or (free and alone.physical)):
        return alone
    others = [one for one in state.selected if one not in alike]
    better, view = refine_together([*alike, alone.selected], state.clean, others)
    return evaluate(better[-1], view, alone.without, test=test)


def moved_to_other_side(
    state: SelectionState, best: Candidate | None
) -> tuple[SelectedEffect, ...] | None:
    """Return the selected effects with a filter on the other side of the hysteresis, if better.

    An amplifier that charges the ceramic slowly rounds the turns of the drive before the walls
    follow, a sensor's filter those of the displacement. A filter on the wrong side leaves a
    residual that looks like rate dependence.

    best  the best candidate: only filters that resemble it are tried, or all where there is none
    """
    for k, one in enumerate(state.selected):
        other = one.effect.other_side
        if other is None or not (best is None or one.effect.resembles(best.effect)):
            continue
        before, behind = state.selected[:k], state.selected[k + 1 :]
        there, view = refine(replace(one, effect=other), state.clean, [*before, *behind], finer=1)
        rivals = [state.view.rms] if best is None else [state.view.rms, best.view.rms]
        if view.rms < OTHER_SIDE * min(rivals):
            return (*before, there, *behind)
    return None


def _with_slips(state: SelectionState) -> SelectionState | None:
    """Look for slips of the clock once more, beside the selected effects.

    What the effects explain hid them when the recordings were searched for faults. In the fast
    half of a chirp a slip resembles a delay of the whole chirp: where the clock is known to slip,
    slips of the same length are tried in the place of each filter.
    """
    if not state.selected or state.view.rms < NOISY * state.view.noise:
        return None
    known = state.faults.get(SLIP)
    samples = None if known is None else round(known.value)
    selections = [state.selected]
    if known is not None:
        selections += [
            tuple(other for other in state.selected if other is not one)
            for one in state.selected
            if one.effect.response_filter is not None
        ]
    for selected in selections:
        view = state.view if selected is state.selected else with_effects(state.clean, selected)
        fault = find_slips_beside(view, partial(_refit, state, selected), samples)
        if fault is None:
            continue
        clean = with_tracks(state.clean, _as_recorded(state, fault.tracks))
        if with_effects(clean, selected).rms < state.view.rms:
            faults = {**state.faults, SLIP: fault.after(known)}
            return state.after(clean=clean, selected=selected, faults=faults, initial=None)
    return None


def _refit(
    state: SelectionState, selected: Sequence[SelectedEffect], tracks: Sequence[Track]
) -> View:
    return with_effects(with_tracks(state.clean, _as_recorded(state, tracks)), selected)


def _as_recorded(state: SelectionState, tracks: Sequence[Track]) -> tuple[Track, ...]:
    """Return the readings of tracks with the commands as they were recorded."""
    return tuple(
        replace(clean, response=track.response, place=track.place, block=track.block)
        for clean, track in zip(state.clean.tracks, tracks, strict=True)
    )
