"""Search for causes: faults of the data, forward selection, model comparison.

Every effect gets a score test by its tangents; the shortlist is refitted with the whole model, and
the one that then leaves the smallest error is selected, if it is significant, physical and clearly
better than its placebos. All are tested again beside it. At the end each must hold beside all
others and not be small beside the structure that the nuisance class leaves, and a confounded
effect that does better replaces it.
"""

from collections.abc import Collection, Mapping
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
    shared_does_as_well,
    with_own_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.model_comparison import Confounded, compare_models
from piezoid.diagnosis.refitted_view import with_effects
from piezoid.diagnosis.residual_view import View, with_shared_reversals, with_tracks
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.formatting import words
from piezoid.numerics.executor import SERIAL, Executor

MOST = 0.65  # share of the power above the noise that unmistakable structure explains
MOST_REPAIRS = 3
EVIDENT = 0.5  # of the error: largest error with an evident shared initial state


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Result of a search.

    first       the view of the raw recordings
    clean       with faults repaired
    final       with all causes at work
    faults      by effect
    causes      every selected effect beside all others
    confounded  effects that would explain as much in the place of a selected one, by its name
    screened    the last score test of each effect that was not selected
    held_back   significant structure beside causes it cannot be separated from
    dismissed   what was selected, or structure that was significant, and has no name
    against     why the class does not apply, so that no cause is looked for; empty where it does
    """

    first: View
    clean: View
    final: View
    faults: Mapping[str, Fault]
    causes: tuple[Candidate, ...]
    confounded: Confounded
    screened: Mapping[str, ScoreTest]
    held_back: tuple[str, ...] = ()
    dismissed: tuple[Candidate, ...] = ()
    against: str = ""


def search(view: View, executor: Executor = SERIAL) -> Outcome:
    """Search for the causes of the residual of the nuisance class."""
    clean, faults, initial = repaired(view, executor)
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
        screened={**_dropped(final, {*named_effects, *state.screened}), **state.screened},
        dismissed=tuple(dismissed),
    )
    return _with_structure(outcome, executor)


def without_causes(view: View, against: str, executor: Executor = SERIAL) -> Outcome:
    """Look for faults of the data alone, where the class of model does not apply.

    against  why it does not

    Whatever stands for a cause there would stand for the missing class. A slip of the clock is
    told by readings against a model, and is not looked for either.
    """
    clean, faults, _ = repaired(view, executor, but=SLIP)
    return Outcome(
        first=view,
        clean=clean,
        final=clean,
        faults=faults,
        causes=(),
        confounded={},
        screened={},
        against=against,
    )


def _dropped(final: View, tested: Collection[str]) -> dict[str, ScoreTest]:
    """Test effects against the final view that were selected and dropped again."""
    screenings = [
        score_test(effect, final)
        for effect in every_effect()
        if effect.structural is None and effect.name not in tested and not effect.untestable(final)
    ]
    return {test.effect.name: test for test in screenings if test is not None}


def _with_structure(outcome: Outcome, executor: Executor) -> Outcome:
    """Test for missing structure of the nuisance class, beside all causes."""
    final = outcome.final
    for effect in every_effect():
        if effect.structural is None or effect.untestable(final):
            continue
        executor.report(f"testing {words(effect.name)}")
        judgement = structural_candidate(effect, final)
        if judgement is None:
            continue
        test, structure = judgement
        if structure.may_be_named and may_be_named(structure, final):
            outcome = replace(outcome, causes=(*outcome.causes, structure))
            continue
        outcome = replace(outcome, screened={**outcome.screened, effect.name: test})
        if structure.is_significant:
            outcome = replace(
                outcome,
                held_back=(*outcome.held_back, effect.name),
                dismissed=(*outcome.dismissed, structure),
                confounded=_with_confounded(outcome.confounded, effect),
            )
    return outcome


def may_be_named(structure: Candidate, final: View) -> bool:
    """Tell whether missing structure may be named: a class that does not fit looks like it."""
    clear = explained_share(structure.cv.gain, final.rms, final.noise) > MOST
    structural = structure.effect.structural
    return clear or structural is None or final.rms < structural.largest_noise_ratio * final.noise


def _with_confounded(confounded: Confounded, effect: Effect) -> Confounded:
    """Add a structural effect to the alternatives of the causes it is confounded with."""
    return {
        name: (*alternatives, effect.name) if name in effect.confounded else alternatives
        for name, alternatives in confounded.items()
    }


def repaired(
    view: View, executor: Executor, *, but: str = ""
) -> tuple[View, dict[str, Fault], InitialStates | None]:
    """Repair faults of the data, and return the repaired view and the faults by effect.

    The initial state is the shared hypothesis if it is evident, else a drive cycled over its
    range. The last value holds the fitted initial states, or None if anything was repaired.

    but  name of a fault that is not searched for
    """
    faults: dict[str, Fault] = {}
    shared = with_shared_initial_state(view, executor)
    individual = with_own_initial_states(view, shared)
    evident = shared.rms < EVIDENT * view.rms and shared_does_as_well(shared, individual, view)
    believed = shared if evident else view
    # a wrong initial state looks like lost readings
    view = individual if individual.rms < OTHER_INITIAL_STATES * believed.rms else believed
    for effect in every_effect():
        if effect.fault is None or effect.name == but:
            continue
        for _ in range(MOST_REPAIRS):
            executor.report(f"looking for {words(effect.name)}")
            fault = effect.fault.find(view)
            if fault is None:
                break
            faults[effect.name] = fault.merged_with(faults.get(effect.name))
            if all(a is b for a, b in zip(fault.tracks, view.tracks, strict=True)):
                break
            view = with_tracks(view, fault.tracks)
    initial = (shared, individual) if view.tracks == individual.tracks else None
    return with_shared_reversals(view, believed.nuisance.reversals), faults, initial
