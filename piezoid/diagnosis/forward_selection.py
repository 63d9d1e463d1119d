"""Forward selection: add one effect after another until none is significant.

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
from piezoid.diagnosis.step_responses import modes_behind_jumps, without_unresolved_ringing
from piezoid.formatting import words
from piezoid.numerics.executor import Executor

FIRST_GAIN = 0.25  # of the best tangent's gain, from which an effect is refitted at first
MIN_GAIN = 0.012  # of the error: tangents err by factors
NEAR_PLACEBO = 0.9  # times its placebo's gain, below which a refit will not help it
NEAR = 3.0  # times the smallest error: largest error of a first refit that is refined
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

    def updated(
        self,
        *,
        clean: View | None = None,
        selected: Sequence[SelectedEffect] | None = None,
        faults: Mapping[str, Fault] | None = None,
        initial: InitialStates | None = None,
    ) -> "SelectionState":
        """Return the state with these parts replaced."""
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
    """Select effects one after another until none is significant.

    initial  of the view, where they are known
    """
    executor.report("looking for modes after steps of the drive")
    selected = modes_behind_jumps(clean)
    clean = without_unresolved_ringing(clean, selected)
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

    selected_names = {effect.effect.name for effect in state.selected}
    effects = {
        effect.name: effect
        for effect in every_effect()
        if effect.structural is None
        and effect.name not in selected_names
        and not effect.untestable(state.view)
    }
    for name, effect in list(effects.items()):
        if effect.between_recordings is not None:
            effects[f"{name} {BETWEEN}"] = effect.between_recordings
    tests = zip(effects, executor.map(tested, effects.values()), strict=True)
    return {name: test for name, test in tests if test is not None}


def _next_state(state: SelectionState, executor: Executor) -> SelectionState | None:
    """Take the step with the smallest error; None if no step reduces it."""
    view = state.view

    def with_bouc_wen_state() -> View:
        return with_best_bouc_wen(view) if view.rms > NOISY * view.noise else view

    best = best_candidate(refit_shortlist(state, executor))
    min_rms = best.view.rms if best else np.inf
    exchanged = moved_to_other_side(state, best)
    if exchanged is not None:
        return state.updated(selected=exchanged)
    if state.initial is None:
        shared = with_shared_initial_state(view, executor)
        individual, bent = executor.run_both(
            lambda: with_own_initial_states(view, shared), with_bouc_wen_state
        )
    else:
        (shared, individual), bent = state.initial, with_bouc_wen_state()
    if bent.rms < min(BOUC_WEN * view.rms, min_rms, individual.rms):
        return state.updated(clean=with_bouc_wen(state.clean, bent.nuisance.bouc_wen))
    if initial_states_explain(individual, view, min_rms):
        # not reused once effects are selected: these depend on the static response
        freed = state.updated(
            clean=with_free_memory(with_reversals(state.clean, individual.nuisance.reversals)),
            initial=None if state.selected else (shared, individual),
        )
        if freed.view.rms < view.rms:  # effects fitted anew beside them may explain less
            return freed
    if best is None:
        return _with_slips(state)
    clean = without_unresolved_ringing(state.clean, [best.selected])
    return state.updated(clean=clean, selected=(*state.selected, best.selected))


def initial_states_explain(individual: View, view: View, min_rms: float) -> bool:
    """Tell whether individual initial states explain more than the best effect (``min_rms``)."""
    return individual.rms < min(OTHER_INITIAL_STATES * view.rms, min_rms)


def refit_shortlist(state: SelectionState, executor: Executor) -> list[Candidate]:
    """Refit the effects with the largest gains, and the others only if none is significant.

    An effect is refitted if its tangent explains enough, and as much as its placebo. Tangents of
    refined parameters are off by factors and are not compared with their placebos.
    """
    hopeful = [f for f in state.screened.values() if f.physical and f.total_gain > MIN_GAIN]
    first_gain = FIRST_GAIN * max((f.total_gain for f in hopeful), default=0.0)
    hopeful = [
        f
        for f in hopeful
        if f.placebo is None or f.trial.free or f.cv.gain > NEAR_PLACEBO * f.placebo.gain
    ]
    candidates = _refitted([f for f in hopeful if f.total_gain > first_gain], state, executor)
    if best_candidate(candidates) is None:
        candidates += _refitted(
            [f for f in hopeful if f.total_gain <= first_gain], state, executor
        )
    return candidates


def best_candidate(candidates: Iterable[Candidate]) -> Candidate | None:
    """Return the significant candidate with the smallest error, or None."""
    significant = [candidate for candidate in candidates if candidate.is_significant]
    return min(significant, key=lambda candidate: candidate.cv.rms, default=None)


def _refitted(
    tests: Sequence[ScoreTest], state: SelectionState, executor: Executor
) -> list[Candidate]:
    """Refit each effect together with the selected ones, unless its initial error is large."""
    clean, selected = state.clean, state.selected
    starts = executor.map(lambda test: _start(test, state), tests)
    errors = executor.map(lambda start: with_effects(clean, [*selected, start]).rms, starts)
    min_rms = min(errors, default=0.0)

    def refit(pair: tuple[SelectedEffect, ScoreTest]) -> Candidate:
        start, test = pair
        executor.report(f"refitting with {words(start.effect.name)}")
        refined, view = refine(start, clean, selected)
        return _refitted_together(evaluate(refined, view, state.view, test=test), state, test)

    hopeful = [
        (start, test)
        for start, test, rms in zip(starts, tests, errors, strict=True)
        if rms <= NEAR * min_rms
    ]
    return executor.map(refit, hopeful)


def _start(test: ScoreTest, state: SelectionState) -> SelectedEffect:
    """Return the initial guess of a refit.

    For filters of the drive the tangent is misleading: the static response was fitted to the
    command, not to the filtered drive, and the error has a second minimum at which the response
    compensates for the wrong limit. There each trial is evaluated, then steps around the best.
    """
    guess = initial_guess(test.effect, test.trial, float(test.cv.coefficient[0]))
    if test.effect.drive_filter is None or test.effect.trials is None:
        return guess

    def error(start: SelectedEffect) -> float:
        return with_effects(state.clean, [*state.selected, start]).rms

    trials = [trial for trial in test.effect.trials(state.view) if trial.physical]
    best = min((guess, *(initial_guess(test.effect, trial, 1.0) for trial in trials)), key=error)
    neighbours = [with_step(best, name, part) for name in best.free for part in ABOUT]
    return min((best, *neighbours), key=error)


def _refitted_together(candidate: Candidate, state: SelectionState, test: ScoreTest) -> Candidate:
    """Refine selected effects that resemble a candidate together with it.

    A delay may become physical that way: beside a limit that absorbs a part of it, it differs from
    recording to recording. With more free parameters than a time this is too expensive.
    """
    free = len(candidate.selected.free)
    alike = [
        effect
        for effect in state.selected
        if effect.free and not effect.from_jumps and effect.effect.resembles(candidate.effect)
    ]
    if not alike or not (free == 1 or (free and candidate.physical)):
        return candidate
    unrelated = [effect for effect in state.selected if effect not in alike]
    refined, view = refine_together([*alike, candidate.selected], state.clean, unrelated)
    return evaluate(refined[-1], view, candidate.without, test=test)


def moved_to_other_side(
    state: SelectionState, best: Candidate | None
) -> tuple[SelectedEffect, ...] | None:
    """Return the selected effects with a filter on the other side of the hysteresis, if better.

    The amplifier rounds reversals of the drive in front of the hysteresis, the filter of a sensor
    those of the displacement behind it. A filter on the wrong side leaves a residual that looks
    like rate dependence.

    best  the best candidate: only filters that resemble it are tried; None: all filters
    """
    for k, selected in enumerate(state.selected):
        exchanged = selected.effect.other_side
        if exchanged is None or not (best is None or selected.effect.resembles(best.effect)):
            continue
        preceding, behind = state.selected[:k], state.selected[k + 1 :]
        refined, view = refine(
            replace(selected, effect=exchanged), state.clean, [*preceding, *behind], finer=1
        )
        rivals = [state.view.rms] if best is None else [state.view.rms, best.view.rms]
        if view.rms < OTHER_SIDE * min(rivals):
            return (*preceding, refined, *behind)
    return None


def _with_slips(state: SelectionState) -> SelectionState | None:
    """Search for clock slips again, beside the selected effects.

    The selected effects may have hidden slips in the first search. In the fast half of a chirp a
    slip resembles a delay of the whole chirp: if a slip is known, slips of the same length are
    also tried instead of each filter.
    """
    if not state.selected or state.view.rms < NOISY * state.view.noise:
        return None
    slip = state.faults.get(SLIP)
    samples = None if slip is None else round(slip.value)
    selections = [state.selected]
    if slip is not None:
        selections += [
            tuple(effect for effect in state.selected if effect is not filtered)
            for filtered in state.selected
            if filtered.effect.response_filter is not None
        ]
    for selected in selections:
        view = state.view if selected is state.selected else with_effects(state.clean, selected)
        fault = find_slips_beside(view, partial(_refit, state, selected), samples)
        if fault is None:
            continue
        clean = with_tracks(state.clean, _as_recorded(state, fault.tracks))
        if with_effects(clean, selected).rms < state.view.rms:
            faults = {**state.faults, SLIP: fault.merged_with(slip)}
            return state.updated(clean=clean, selected=selected, faults=faults, initial=None)
    return None


def _refit(
    state: SelectionState, selected: Sequence[SelectedEffect], tracks: Sequence[Track]
) -> View:
    return with_effects(with_tracks(state.clean, _as_recorded(state, tracks)), selected)


def _as_recorded(state: SelectionState, tracks: Sequence[Track]) -> tuple[Track, ...]:
    """Return the readings of tracks with the commands as they were recorded."""
    return tuple(
        replace(clean, response=track.response, rows=track.rows, block=track.block)
        for clean, track in zip(state.clean.tracks, tracks, strict=True)
    )
