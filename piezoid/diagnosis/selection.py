"""Search for causes: faults of the data, forward selection, model comparison.

Every effect gets a score test by its tangents. A shortlist is refitted with the whole model, and
the effect with the smallest error is selected if it is significant, physical and clearly better
than its placebos. All other effects are then tested again beside it. At the end each selected
effect must be significant beside all others and not be small beside the structure of the residual,
and confounded effects that explain as much are reported with it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from piezoid.diagnosis.candidate import (
    Candidate,
    explained_share,
    structural_candidate,
)
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.forward_selection import SLIP, select_forward
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    InitialStates,
    is_shared_state_as_good,
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.model_comparison import Confounded, compare_models
from piezoid.diagnosis.refitted_view import with_effects
from piezoid.diagnosis.residual_view import View, with_shared_reversals, with_tracks
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.formatting import words
from piezoid.numerics.executor import SERIAL, Executor

CLEAR_SHARE = 0.65  # explained share of the power above the noise from which structure is clear
MAX_REPAIRS = 3
EVIDENT = 0.5  # largest relative error at which a shared initial state is evident


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Result of a search.

    first        view before any fault was repaired
    clean        view with faults repaired
    final        view with all causes in the model
    faults       by effect
    causes       every selected effect, evaluated beside all others
    confounded   effects that would explain as much instead of a selected effect, by its name
    score_tests  the last score test of each effect that was not selected
    dismissed    selected effects and significant structure that may not be named
    doubtful     selected effects that are not named because the model does not need them
    rejection    why the model class does not apply and no cause was searched; empty if it applies
    """

    first: View
    clean: View
    final: View
    faults: Mapping[str, Fault]
    causes: tuple[Candidate, ...]
    confounded: Confounded
    score_tests: Mapping[str, ScoreTest]
    dismissed: tuple[Candidate, ...] = ()
    doubtful: tuple[Candidate, ...] = ()
    rejection: str = ""

    @property
    def inseparable(self) -> tuple[str, ...]:
        """Return the significant structural effects that the causes cannot be separated from."""
        return tuple(c.effect.name for c in self.dismissed if c.effect.structural is not None)


def search(view: View, executor: Executor = SERIAL) -> Outcome:
    """Search for the causes of the residual of the nuisance class."""
    clean, faults, initial = repair_faults(view, executor)
    state = select_forward(clean, faults, executor, initial)
    causes, confounded, dismissed = compare_models(state.clean, state.selected, executor)
    final = with_effects(state.clean, [cause.selected for cause in causes])
    named_effects = {cause.effect.name for cause in causes}
    outcome = Outcome(
        first=view,
        clean=state.clean,
        final=final,
        faults=state.faults,
        causes=tuple(causes),
        confounded=confounded,
        score_tests={
            **_test_dropped_effects(final, {*named_effects, *state.score_tests}),
            **state.score_tests,
        },
        dismissed=tuple(dismissed),
    )
    return _with_structure(outcome, executor)


def search_faults(view: View, rejection: str, executor: Executor = SERIAL) -> Outcome:
    """Search for faults of the data only, because the model class does not apply.

    rejection  why the class does not apply

    An effect would compensate for the missing class, and so would a clock slip, which is detected
    by comparing readings with a model. Neither is searched.
    """
    clean, faults, _ = repair_faults(view, executor, skipped=SLIP)
    return Outcome(
        first=view,
        clean=clean,
        final=clean,
        faults=faults,
        causes=(),
        confounded={},
        score_tests={},
        rejection=rejection,
    )


def without_causes(outcome: Outcome, causes: Sequence[Candidate]) -> Outcome:
    """Return the outcome without causes that the model does not need."""
    remaining = tuple(cause for cause in outcome.causes if cause not in causes)
    final = with_effects(outcome.clean, [cause.selected for cause in remaining])
    named_effects = {cause.effect.name for cause in remaining}
    return replace(
        outcome,
        final=final,
        causes=remaining,
        doubtful=tuple(causes),
        score_tests={
            **_test_dropped_effects(final, {*named_effects, *outcome.score_tests}),
            **outcome.score_tests,
        },
    )


def _test_dropped_effects(final: View, tested: Collection[str]) -> dict[str, ScoreTest]:
    """Test effects on the final view that were selected and dropped again."""
    tests = [
        score_test(effect, final)
        for effect in every_effect()
        if effect.structural is None and effect.name not in tested and not effect.untestable(final)
    ]
    return {test.effect.name: test for test in tests if test is not None}


def _with_structure(outcome: Outcome, executor: Executor) -> Outcome:
    """Test the structural effects, beside all causes."""
    final = outcome.final
    for effect in every_effect():
        if effect.structural is None or effect.untestable(final):
            continue
        executor.report(f"testing {words(effect.name)}")
        result = structural_candidate(effect, final)
        if result is None:
            continue
        test, structure = result
        if structure.may_be_named and exceeds_misfit(structure, final):
            outcome = replace(outcome, causes=(*outcome.causes, structure))
            continue
        outcome = replace(outcome, score_tests={**outcome.score_tests, effect.name: test})
        if structure.is_significant:
            outcome = replace(
                outcome,
                dismissed=(*outcome.dismissed, structure),
                confounded=_with_confounded(outcome.confounded, effect),
            )
    return outcome


def exceeds_misfit(structure: Candidate, final: View) -> bool:
    """Tell whether a structural effect is clear or the nuisance class fits well.

    The residual of a misspecified class resembles missing structure.
    """
    structural = structure.effect.structural
    assert structural is not None
    is_clear = explained_share(structure.cv.gain, final.rms, final.noise) > CLEAR_SHARE
    return is_clear or final.rms < structural.largest_noise_ratio * final.noise


def _with_confounded(confounded: Confounded, effect: Effect) -> Confounded:
    """Add a structural effect to the alternatives of the causes it is confounded with."""
    return {
        name: (*alternatives, effect.name) if name in effect.confounded else alternatives
        for name, alternatives in confounded.items()
    }


def repair_faults(
    view: View, executor: Executor, *, skipped: str = ""
) -> tuple[View, dict[str, Fault], InitialStates | None]:
    """Repair faults of the data, and return the repaired view and the faults by effect.

    The initial state is the shared hypothesis if it is evident, else a drive cycled over its
    range. The last value holds the fitted initial states, or None if anything was repaired.

    skipped  name of a fault that is not searched
    """
    faults: dict[str, Fault] = {}
    shared = with_shared_initial_state(view, executor)
    individual = with_individual_initial_states(view, shared)
    is_evident = shared.rms < EVIDENT * view.rms and is_shared_state_as_good(
        shared, individual, view
    )
    assumed = shared if is_evident else view
    # a wrong initial state looks like lost readings
    view = individual if individual.rms < OTHER_INITIAL_STATES * assumed.rms else assumed
    for effect in every_effect():
        if effect.fault is None or effect.name == skipped:
            continue
        for _ in range(MAX_REPAIRS):
            executor.report(f"looking for {words(effect.name)}")
            fault = effect.fault.find(view)
            if fault is None:
                break
            faults[effect.name] = fault.merged_with(faults.get(effect.name))
            if all(a is b for a, b in zip(fault.tracks, view.tracks, strict=True)):
                break
            view = with_tracks(view, fault.tracks)
    initial = (shared, individual) if view.tracks == individual.tracks else None
    return with_shared_reversals(view, assumed.nuisance.reversals), faults, initial
