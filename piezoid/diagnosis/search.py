"""The search for causes: faults first, then one effect at a time, then what is not needed goes.

All effects are screened by their tangents; the telling ones are refitted with the whole model, and
the one that then leaves least is selected, if it is sure, physical and clearly better than its
placebos. Everything is screened again beside it. At the end each effect must still be
worth its place beside all others, and a confounded effect that does better replaces it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from piezoid.diagnosis.bouc_wen_search import with_best_bouc_wen
from piezoid.diagnosis.candidate import (
    Candidate,
    asked,
    part_explained,
    structural_candidate,
)
from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import SelectedEffect, extended
from piezoid.diagnosis.forward_selection import SLIP, SelectionState, select_forward
from piezoid.diagnosis.model_comparison import Confounded, told_apart
from piezoid.diagnosis.refinement import refined
from piezoid.diagnosis.repair import repaired
from piezoid.diagnosis.score_test import ScoreTest, screen
from piezoid.diagnosis.view import View, with_tracks
from piezoid.numerics.hands import ALONE, Hands

WORTH = 0.02  # of the rms: what removing a cause must lose, or half of it near the noise
CLEARLY = 0.2  # of the error: what structure takes off that nothing else here looks like,
MOST = 0.65  # and of what is no noise, in power
UNEXPLAINED = 1.3  # times the sensor's noise: what no search should leave
FAR_LESS = 0.85  # of the error: what another beginning must leave to be believed
QUIET = 1.5  # times the sensor's noise: so little they may leave


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a search came to.

    first     the view of the raw recordings
    clean     with faults repaired
    final     with all causes at work
    faults    by effect
    causes    every selected effect beside all others
    confounded  effects that would explain as much in the place of a selected one, by its name
    screened  the last word on each effect that was not selected
    held_back structure that speaks, but beside more than it can be told from
    against   why the class does not apply, so that no cause is looked for; empty where it does
    """

    first: View
    clean: View
    final: View
    faults: Mapping[str, Fault]
    causes: tuple[Candidate, ...]
    confounded: Confounded
    screened: Mapping[str, ScoreTest]
    held_back: tuple[str, ...] = ()
    against: str = ""


def search(view: View, hands: Hands = ALONE) -> Outcome:
    """Find the causes of what the nuisance class cannot follow."""
    clean, faults = repaired(view, hands)
    state = _best_selection(clean, faults, hands)
    if SLIP in state.faults and state.selected:
        state = _without_slips(view, state, hands)
    causes, confounded = told_apart(state.clean, state.selected, hands)
    final = extended(state.clean, [cause.selected for cause in causes])
    named = {cause.effect.name for cause in causes}
    found = Outcome(
        first=view,
        clean=state.clean,
        final=final,
        faults=state.faults,
        causes=tuple(causes),
        confounded=confounded,
        screened={**_dropped(final, {*named, *state.screened}), **state.screened},
    )
    return _with_structure(found, hands)


def without_causes(view: View, against: str, hands: Hands = ALONE) -> Outcome:
    """Look for faults of the data alone, where the class of model does not apply.

    against  why it does not

    Whatever stands for a cause there would stand for the missing class. A slip of the clock is
    told by readings against a model, and is not looked for either.
    """
    clean, faults = repaired(view, hands, but=SLIP)
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


def _best_selection(clean: View, faults: Mapping[str, Fault], hands: Hands) -> SelectionState:
    """Grow from a sum of plays, and where much is left over again from a Bouc-Wen state.

    One effect after another, the least that is left first, may end where no way leads on: what the
    class itself cannot follow is taken for initial states, and these hide the cause.
    """
    state = _selected(clean, faults, hands)
    left = extended(state.clean, state.selected)
    if left.rms < UNEXPLAINED * left.noise:
        return state
    hands.say("beginning again with one more state of hysteresis")
    other = _selected(with_best_bouc_wen(clean, hands), faults, hands)
    return other if extended(other.clean, other.selected).rms < FAR_LESS * left.rms else state


def _selected(clean: View, faults: Mapping[str, Fault], hands: Hands) -> SelectionState:
    state = select_forward(clean, faults, hands)
    return replace(state, selected=_pruned(state.clean, state.selected, hands))


def _dropped(final: View, known: Collection[str]) -> dict[str, ScoreTest]:
    """Return the last word on effects that were selected once and are not any more."""
    screenings = [
        screen(effect, final)
        for effect in EFFECTS
        if effect.null_without is None
        and effect.name not in known
        and not effect.untestable(final)
    ]
    return {found.effect.name: found for found in screenings if found is not None}


def _with_structure(outcome: Outcome, hands: Hands) -> Outcome:
    """Judge the nuisance class's own structure, with all causes at work."""
    final = outcome.final
    for effect in EFFECTS:
        if effect.null_without is None or effect.untestable(final):
            continue
        beside = any(cause.effect.resembles(effect) for cause in outcome.causes)
        hands.say(f"testing {effect.name.replace('_', ' ')}")
        judgement = structural_candidate(effect, final)
        if judgement is None:
            continue
        found, structure = judgement
        if structure.is_significant and _stands(structure, final, beside=beside):
            outcome = replace(outcome, causes=(*outcome.causes, structure))
            continue
        outcome = replace(outcome, screened={**outcome.screened, effect.name: found})
        if structure.is_significant:
            outcome = replace(
                outcome,
                held_back=(*outcome.held_back, effect.name),
                confounded=_with_confounded(outcome.confounded, effect),
            )
    return outcome


def _stands(structure: Candidate, final: View, *, beside: bool) -> bool:
    """Tell whether structure may be named: what causes leave over looks like it as well.

    beside  whether one of the causes looks alike
    """
    if not beside:
        gain = structure.cv.gain
        clear = gain > CLEARLY and part_explained(gain, final.rms, final.noise) > MOST
        return clear or final.rms < structure.effect.largest_noise_ratio * final.noise
    # and no half of it
    worth = structure.cv.gain > structure.effect.minimum_gain or structure.explains_the_rest
    return worth and final.rms < min(structure.effect.largest_noise_ratio, QUIET) * final.noise


def _with_confounded(confounded: Confounded, effect: Effect) -> Confounded:
    """Say of causes that this structure may be what they are, or a part of them."""
    return {
        name: (*near, effect.name) if name in effect.confounded else near
        for name, near in confounded.items()
    }


def _without_slips(view: View, state: SelectionState, hands: Hands) -> SelectionState:
    """Take slips back, and out of the faults, where the causes leave less without them.

    A limit of the amplifier that a chirp meets from one instant on looks like one.
    """
    hands.say("asking whether a clock slipped at all")
    rest, faults = repaired(view, hands, but=SLIP)
    raw, again = with_tracks(state.clean, rest.tracks), list(state.selected)
    for k, one in enumerate(state.selected):
        if one.struck:
            continue
        others = [other for n, other in enumerate(again) if n != k]
        again[k], _ = refined(one, raw, others, finer=1)
    if extended(raw, again).rms > extended(state.clean, state.selected).rms:
        return state
    return replace(state, clean=raw, selected=tuple(again), faults=faults)


def _pruned(
    clean: View, selected: Sequence[SelectedEffect], hands: Hands
) -> tuple[SelectedEffect, ...]:
    """Take out, one by one, what is no longer worth its place beside the others.

    What was struck by jumps is worth its place behind them, whatever it is elsewhere.
    """
    selected = tuple(selected)
    while len(selected) > 1 and not all(one.struck for one in selected):
        hands.say("taking out what is not needed")
        whole = extended(clean, selected).rms
        spare = [one for one in selected if not one.struck]
        rests = [tuple(o for o in selected if o is not one) for one in spare]
        views = hands.each(lambda rest: extended(clean, rest), rests)
        losses = [(1.0 - whole / view.rms) / asked(view) for view in views]
        if min(losses) >= WORTH:
            return selected
        selected = rests[losses.index(min(losses))]
    return selected
