"""Forward selection: one effect after another is added to those selected before.

Every step all effects get a score test; the shortlist is refitted with the whole model, and the
effect that leaves the smallest error is selected, unless other initial states or a Bouc-Wen state
leave less.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.bouc_wen_search import with_best_bouc_wen
from piezoid.diagnosis.effect import BETWEEN, Effect, Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    with_own_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.jumps import modes_behind_jumps
from piezoid.diagnosis.other_side import moved_to_other_side
from piezoid.diagnosis.refinement import refined
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.diagnosis.shortlist import SelectionContext, best_candidate, refit_shortlist
from piezoid.diagnosis.slip_alternative import slips_in_place
from piezoid.diagnosis.view import (
    View,
    with_bouc_wen,
    with_free_memory,
    with_reversals,
)
from piezoid.numerics.executor import Executor

MOST_CAUSES = 5
SLIP = "timestamp_fault"
NOISY = 1.1  # residual/noise below which no structure of hysteresis is looked for
BOUC_WEN = 0.97  # largest relative error at which a Bouc-Wen state is taken in


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectionState:
    """The state of the selection after a step.

    clean     the view of repaired tracks, with the initial states and Bouc-Wen state taken in
    selected  effects, in the order in which they were selected
    faults    of the data, by effect
    screened  the last score test of each effect that was not selected, also ``BETWEEN`` recordings
    """

    clean: View
    selected: tuple[SelectedEffect, ...]
    faults: Mapping[str, Fault]
    screened: Mapping[str, ScoreTest]


def select_forward(clean: View, faults: Mapping[str, Fault], executor: Executor) -> SelectionState:
    """Select one effect after another until none is evidence."""
    executor.report("looking behind jumps of the drive")
    state = SelectionState(
        clean=clean, selected=modes_behind_jumps(clean), faults=faults, screened={}
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
    beside = SelectionContext(clean=state.clean, selected=state.selected, view=view)
    tried = refit_shortlist(state.screened.values(), beside, executor)
    best = best_candidate(tried)
    least = best.view.rms if best else np.inf
    moved = moved_to_other_side(beside, best)
    if moved is not None:
        return replace(state, selected=moved)
    shared = with_shared_initial_state(view, executor)
    own, bent = executor.both(
        lambda: with_own_initial_states(view, shared),
        lambda: with_best_bouc_wen(view) if view.rms > NOISY * view.noise else view,
    )
    if bent.rms < min(BOUC_WEN * view.rms, least, own.rms):
        return replace(state, clean=with_bouc_wen(state.clean, bent.nuisance.bouc_wen))
    # an effect that is evidence but too small to name speaks against other initial states
    least = min([least, *(one.view.rms for one in tried if one.is_evidence)])
    if own.rms < min(OTHER_INITIAL_STATES * view.rms, least):
        return replace(
            state, clean=with_free_memory(with_reversals(state.clean, own.nuisance.reversals))
        )
    if best is None:
        return _with_slips_in_place(state, view)
    return replace(state, selected=_settled(state.clean, [*state.selected, best.selected]))


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
            return replace(state, clean=slips[0], selected=rest, faults=faults)
    return None


def _score_all(view: View, named: set[str], executor: Executor) -> dict[str, ScoreTest]:
    def screened(effect: Effect) -> ScoreTest | None:
        executor.report(f"testing {effect.name.replace('_', ' ')}")
        return score_test(effect, view)

    others = [e for e in EFFECTS if e.null_without is None and e.name not in named]
    others = [effect for effect in others if not effect.untestable(view)]
    between = {
        f"{e.name} {BETWEEN}": e.between_recordings
        for e in others
        if e.between_recordings is not None
    }
    asked = {**{effect.name: effect for effect in others}, **between}
    found = zip(asked, executor.map(screened, asked.values()), strict=True)
    return {name: one for name, one in found if one is not None}


def _settled(clean: View, selected: Sequence[SelectedEffect]) -> tuple[SelectedEffect, ...]:
    """Refine the older effects beside the newest."""
    settled = list(selected)
    for k, one in enumerate(selected[:-1]):
        if one.free:
            rest = [other for other in settled if other is not one]
            settled[k], _ = refined(one, clean, rest, finer=1)
    return tuple(settled)
