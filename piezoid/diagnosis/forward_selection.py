"""Forward selection: add one effect after another until none is significant.

Each step adds the effect with the smallest error, unless a change without a new effect explains as
much: a selected filter on the other side of the hysteresis, a Bouc-Wen state, or other initial
states. If no effect is significant, clock slips are tried instead of a filter. Resonances after
jumps of the drive are selected before all other effects, on the step responses.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.candidate import Candidate, evaluate
from piezoid.diagnosis.effect import BETWEEN, Effect, Fault, Parameters, Trial
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.effects.timestamp_fault import find_equal_slips, find_slips
from piezoid.diagnosis.nuisance_search import (
    OTHER_INITIAL_STATES,
    InitialStates,
    with_best_bouc_wen,
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.refinement import (
    SelectedEffect,
    initial_guess,
    refine,
    with_effects,
    with_parameter_tangents,
    with_step,
)
from piezoid.diagnosis.residual_view import (
    View,
    with_bouc_wen,
    with_free_memory,
    with_reversals,
    with_tracks,
)
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.step_responses import step_response_view, without_unresolved_ringing
from piezoid.formatting import words
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Executor, Once

FIRST_GAIN = 0.25  # gain over that of the best tangent from which an effect is refitted first
MIN_GAIN = 0.012  # of the error: tangents err by factors
MIN_PLACEBO_RATIO = 0.9  # gain over that of the placebo below which no refit makes up for it
MAX_START_RATIO = 3.0  # error over the smallest: largest error of start values that are refined
NEIGHBOURS = (-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6)  # steps from a trial to beyond the next
OTHER_SIDE = 0.98  # largest relative error at which a filter changes its side
MAX_EFFECTS = 5
SLIP = "timestamp_fault"
MIN_NOISE_RATIO = 1.1  # residual/noise below which no structure of hysteresis is searched
# Error with slips instead of a filter over that with the filter, if no slip was detected. For
# slips of two rows in two recordings of a Duhem stage it was 0.80; on seven delays of seven laws
# slips did not reach it.
MAX_SLIP_ERROR = 0.9
BOUC_WEN = 0.97  # largest relative error at which a Bouc-Wen state is added


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionState:
    """State of the selection after a step.

    clean        view of the repaired tracks, with the selected initial states and Bouc-Wen state
    selected     effects, in the order in which they were selected
    view         the view with the selected effects
    faults       of the data, by effect
    score_tests  the last score test of each effect that was not selected, also ``BETWEEN``
                 recordings
    initial      views with the best shared and the best individual initial states, if computed
    """

    clean: View
    selected: tuple[SelectedEffect, ...]
    view: View
    faults: Mapping[str, Fault]
    score_tests: Mapping[str, ScoreTest]
    initial: InitialStates | None = None

    @property
    def fixed(self) -> tuple[SelectedEffect, ...]:
        """Return the effects that were refined on step responses, which come first."""
        return tuple(effect for effect in self.selected if effect.from_jumps)

    @Once
    def test_view(self) -> View:
        """Return the view in which the free parameters of the selected effects may change."""
        return with_parameter_tangents(self.view, self.clean, self.selected, fixed=len(self.fixed))

    def updated(
        self,
        *,
        clean: View | None = None,
        selected: Sequence[SelectedEffect] | None = None,
        faults: Mapping[str, Fault] | None = None,
        initial: InitialStates | None = None,
    ) -> "SelectionState":
        """Return the state with the stated fields replaced; without ``initial`` it has none."""
        clean = self.clean if clean is None else clean
        selected = self.selected if selected is None else tuple(selected)
        return SelectionState(
            clean=clean,
            selected=selected,
            view=with_effects(clean, selected),
            faults=self.faults if faults is None else faults,
            score_tests=self.score_tests,
            initial=initial,
        )


def select_forward(
    clean: View,
    faults: Mapping[str, Fault],
    executor: Executor,
    initial: InitialStates | None,
) -> SelectionState:
    """Select effects one after another until none is significant.

    initial  views with shared and with individual initial states, if computed
    """
    executor.report("looking for modes after steps of the drive")
    selected = modes_after_steps(clean)
    clean = without_unresolved_ringing(clean, selected)
    state = SelectionState(
        clean=clean,
        selected=selected,
        view=with_effects(clean, selected),
        faults=faults,
        score_tests={},
        initial=None if selected else initial,
    )
    for _ in range(MAX_EFFECTS + 2):
        state = replace(state, score_tests=_score_all(state, executor))
        next_state = _next_state(state, executor)
        if next_state is None:
            break
        state = next_state
    return state


def modes_after_steps(view: View) -> tuple[SelectedEffect, ...]:
    """Return the resonances that are significant in step responses, refined on these."""
    step_responses, modes = step_response_view(view), []
    if step_responses is None:
        return ()
    for mode in every_effect():
        if not mode.may_be_absorbed or mode.untestable(step_responses):
            continue
        effect = with_any_phase(mode)
        test = score_test(effect, step_responses)
        if test is None or not test.physical:
            continue
        guess = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
        (refined,), refined_view = refine([guess], step_responses)
        if evaluate(refined, refined_view, step_responses, test=test).is_significant:
            modes.append(replace(refined, from_jumps=True))
    return tuple(modes)


def with_any_phase(effect: Effect) -> Effect:
    """Return the effect with its columns and the same columns delayed by one sample.

    A jump lies between two samples, so its response is delayed by a fraction of a sample: a
    weighted sum of both columns.
    """
    assert effect.trials is not None
    assert effect.columns is not None
    trials, columns = effect.trials, effect.columns

    def two_phases(view: View, parameters: Parameters) -> Array:
        tracks = [replace(track, rows=np.maximum(track.rows - 1, 0)) for track in view.tracks]
        delayed = replace(with_tracks(view, tracks), static_override=view.static)
        return np.hstack([columns(view, parameters), columns(delayed, parameters)])

    def two_phase_trials(view: View) -> list[Trial]:
        return [
            replace(
                trial,
                columns=two_phases(view, trial.parameters),
                coefficient_range=(-np.inf, np.inf),
            )
            for trial in trials(view)
        ]

    return replace(effect, trials=two_phase_trials, columns=two_phases)


def _score_all(state: SelectionState, executor: Executor) -> dict[str, ScoreTest]:
    def run_test(effect: Effect) -> ScoreTest | None:
        executor.report(f"testing {words(effect.name)}")
        return score_test(effect, state.test_view)

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
    tests = zip(effects, executor.map(run_test, effects.values()), strict=True)
    return {name: test for name, test in tests if test is not None}


def _next_state(state: SelectionState, executor: Executor) -> SelectionState | None:
    """Take the step with the smallest error; None if no step reduces it."""
    view = state.view

    def search_bouc_wen() -> View:
        return with_best_bouc_wen(view) if view.rms > MIN_NOISE_RATIO * view.noise else view

    best = best_candidate(refit_shortlist(state, executor))
    min_rms = best.view.rms if best else np.inf
    selected = exchange_filter_side(state, best)
    if selected is not None:
        return state.updated(selected=selected)
    if state.initial is None:
        shared = with_shared_initial_state(view, executor)
        individual, bouc_wen = executor.run_both(
            lambda: with_individual_initial_states(view, shared), search_bouc_wen
        )
    else:
        (shared, individual), bouc_wen = state.initial, search_bouc_wen()
    if bouc_wen.rms < min(BOUC_WEN * view.rms, min_rms, individual.rms):
        return state.updated(clean=with_bouc_wen(state.clean, bouc_wen.nuisance.bouc_wen))
    if initial_states_explain(individual, view, min_rms):
        # selected effects depend on the static response, so initial states are not reused then
        next_state = state.updated(
            clean=with_free_memory(with_reversals(state.clean, individual.nuisance.reversals)),
            initial=None if state.selected else (shared, individual),
        )
        if next_state.view.rms < view.rms:  # effects refitted beside them may explain less
            return next_state
    if best is None:
        return _with_slips(state)
    clean = without_unresolved_ringing(state.clean, [best.selected])
    return state.updated(clean=clean, selected=(*best.others, best.selected))


def initial_states_explain(individual: View, view: View, min_rms: float) -> bool:
    """Tell whether individual initial states explain more than the best effect (``min_rms``)."""
    return individual.rms < min(OTHER_INITIAL_STATES * view.rms, min_rms)


def refit_shortlist(state: SelectionState, executor: Executor) -> list[Candidate]:
    """Refit the effects with the largest gains, and other effects only if none is significant.

    An effect is refitted if its tangent explains enough, and as much that its placebo does not
    explain as the reverse. Tangents of refined parameters are off by factors and are not compared
    with their placebos.
    """
    tests = [t for t in state.score_tests.values() if t.physical and t.total_gain > MIN_GAIN]
    first_gain = FIRST_GAIN * max((test.total_gain for test in tests), default=0.0)
    tests = [
        test
        for test in tests
        if test.placebo is None
        or test.trial.free
        or test.placebo.effect_given_placebo.gain
        > MIN_PLACEBO_RATIO * test.placebo.placebo_given_effect.gain
    ]
    candidates = _refit_effects([t for t in tests if t.total_gain > first_gain], state, executor)
    if best_candidate(candidates) is None:
        candidates += _refit_effects(
            [t for t in tests if t.total_gain <= first_gain], state, executor
        )
    return candidates


def best_candidate(candidates: Iterable[Candidate]) -> Candidate | None:
    """Return the significant candidate with the smallest error, or None."""
    significant = [candidate for candidate in candidates if candidate.is_significant]
    return min(significant, key=lambda candidate: candidate.cv.rms, default=None)


def _refit_effects(
    tests: Sequence[ScoreTest], state: SelectionState, executor: Executor
) -> list[Candidate]:
    """Refit each effect beside the selected ones, unless its start values have a large error.

    A candidate is refined together with the selected effects: a mode fitted without the delay
    behind it absorbs a part of the delay.
    """
    clean, selected = state.clean, state.selected
    fixed, free = state.fixed, state.selected[len(state.fixed) :]
    starts = executor.map(lambda test: _start_values(test, state), tests)
    errors = executor.map(
        lambda start: with_effects(clean, [*selected, start], state.view).rms, starts
    )
    min_rms = min(errors, default=0.0)

    def refit(pair: tuple[SelectedEffect, ScoreTest]) -> Candidate:
        start, test = pair
        executor.report(f"refitting with {words(start.effect.name)}")
        (*others, refined), view = refine([*free, start], clean, fixed, start=state.view)
        candidate = evaluate(refined, view, state.test_view, test=test)
        return replace(candidate, others=(*fixed, *others))

    return executor.map(
        refit,
        [
            (start, test)
            for start, test, rms in zip(starts, tests, errors, strict=True)
            if rms <= MAX_START_RATIO * min_rms
        ],
    )


def _start_values(test: ScoreTest, state: SelectionState) -> SelectedEffect:
    """Return the start values of a refit: those of the tangent, or of the best trial of a filter.

    For filters of the drive the tangent is misleading: the static response was fitted to the
    command, not to the filtered drive, and the error has a second minimum at which the response
    compensates for the wrong limit. There each trial is evaluated, then steps around the best.
    """
    guess = initial_guess(test.effect, test.trial, float(test.cv.coefficient[0]))
    if test.effect.drive_filter is None or test.effect.trials is None:
        return guess

    def error(start: SelectedEffect) -> float:
        return with_effects(state.clean, [*state.selected, start], state.view).rms

    trials = [trial for trial in test.effect.trials(state.view) if trial.physical]
    best = min((guess, *(initial_guess(test.effect, trial, 1.0) for trial in trials)), key=error)
    neighbours = [with_step(best, name, step) for name in best.free for step in NEIGHBOURS]
    return min((best, *neighbours), key=error)


def exchange_filter_side(
    state: SelectionState, best: Candidate | None
) -> tuple[SelectedEffect, ...] | None:
    """Return the selected effects with a filter on the other side of the hysteresis, if better.

    The amplifier rounds reversals of the drive in front of the hysteresis, the filter of a sensor
    those of the displacement behind it. A filter on the wrong side causes a residual that looks
    like rate dependence.

    best  the best candidate: only filters that resemble it are tried; None: all filters
    """
    min_rms = state.view.rms if best is None else min(state.view.rms, best.view.rms)
    for k, selected in enumerate(state.selected):
        other_side = selected.effect.other_side
        if other_side is None or not (best is None or selected.effect.resembles(best.effect)):
            continue
        preceding, following = state.selected[:k], state.selected[k + 1 :]
        (refined,), view = refine(
            [replace(selected, effect=other_side)], state.clean, [*preceding, *following]
        )
        if view.rms < OTHER_SIDE * min_rms:
            return (*preceding, refined, *following)
    return None


def _with_slips(state: SelectionState) -> SelectionState | None:
    """Search for clock slips again, beside the selected effects.

    The selected effects may have hidden slips in the first search. If the speed rises along a
    recording, a slip resembles a delay of all of it: slips of that length are also tried instead
    of a delay, and if other slips were detected, slips of their length instead of each filter.
    """
    if not state.selected or state.view.rms < MIN_NOISE_RATIO * state.view.noise:
        return None
    slip, fastest_Hz = state.faults.get(SLIP), max(track.rate_Hz for track in state.clean.tracks)
    filters = [effect for effect in state.selected if effect.effect.response_filter is not None]
    for replaced in (None, *filters):
        selected = tuple(effect for effect in state.selected if effect is not replaced)
        view, max_rms, length = state.view, state.view.rms, 0.0
        if replaced is not None:
            view, numbers = with_effects(state.clean, selected), replaced.parameters
            length = numbers.get("delay_s", 0.0) * fastest_Hz + numbers.get("delay_samples", 0.0)
            max_rms *= MAX_SLIP_ERROR
        if slip is not None:
            max_rms, length = state.view.rms, slip.value

        def refit(tracks: Sequence[Track], selected: Sequence[SelectedEffect] = selected) -> View:
            return with_effects(_with_readings(state.clean, tracks), selected)

        fault = find_slips(view, refit) if replaced is None or slip is not None else None
        if fault is None and round(length):
            fault = find_equal_slips(view, refit, round(length))
        if fault is None:
            continue
        clean = _with_readings(state.clean, fault.tracks)
        if with_effects(clean, selected).rms < max_rms:
            faults = {**state.faults, SLIP: fault.merged_with(slip)}
            return state.updated(clean=clean, selected=selected, faults=faults, initial=None)
    return None


def _with_readings(view: View, tracks: Sequence[Track]) -> View:
    """Return the view with the readings of these tracks and the commands as recorded."""
    recorded = [
        replace(recorded, response=track.response, rows=track.rows, block=track.block)
        for recorded, track in zip(view.tracks, tracks, strict=True)
    ]
    return with_tracks(view, recorded)
