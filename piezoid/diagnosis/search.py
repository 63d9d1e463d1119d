"""The search for causes: faults first, then one effect at a time, then what is not needed goes.

All effects are screened by their tangents; the telling ones are refitted with the whole model, and
the one that then leaves least is accepted, if it is sure, physical and clearly better than its
unphysical twins. Everything is screened again beside it. At the end each effect must still be
worth its place with all others there, and a rival that does better in its place takes it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.growth import SLIP, Grown, grown
from piezoid.diagnosis.judgement import Judged, asked, judged_structure, part_explained
from piezoid.diagnosis.knee import with_best_knee
from piezoid.diagnosis.refinement import refined
from piezoid.diagnosis.repair import repaired
from piezoid.diagnosis.rivals import Rivals, told_apart
from piezoid.diagnosis.screening import Screened, screen
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
    causes    every accepted effect beside all others
    rivals    effects that would explain as much in the place of an accepted one, by its name
    screened  the last word on each effect that was not accepted
    held_back structure that speaks, but beside more than it can be told from
    against   why the class does not apply, so that no cause is looked for; empty where it does
    """

    first: View
    clean: View
    final: View
    faults: Mapping[str, Fault]
    causes: tuple[Judged, ...]
    rivals: Rivals
    screened: Mapping[str, Screened]
    held_back: tuple[str, ...] = ()
    against: str = ""


def search(view: View, hands: Hands = ALONE) -> Outcome:
    """Find the causes of what the envelope cannot follow."""
    clean, faults = repaired(view, hands)
    far = _best_grown(clean, faults, hands)
    if SLIP in far.faults and far.accepted:
        far = _without_slips(view, far, hands)
    causes, rivals = told_apart(far.clean, far.accepted, hands)
    final = extended(far.clean, [cause.accepted for cause in causes])
    named = {cause.effect.name for cause in causes}
    found = Outcome(
        first=view,
        clean=far.clean,
        final=final,
        faults=far.faults,
        causes=tuple(causes),
        rivals=rivals,
        screened={**_dropped(final, {*named, *far.screened}), **far.screened},
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
        rivals={},
        screened={},
        against=against,
    )


def _best_grown(clean: View, faults: Mapping[str, Fault], hands: Hands) -> Grown:
    """Grow from a sum of plays, and where much is left over again from a Bouc-Wen state.

    One effect after another, the least that is left first, may end where no way leads on: what the
    class itself cannot follow is taken for pasts, and these hide the cause.
    """
    far = _grown(clean, faults, hands)
    left = extended(far.clean, far.accepted)
    if left.rms < UNEXPLAINED * left.noise:
        return far
    hands.say("beginning again with one more state of hysteresis")
    other = _grown(with_best_knee(clean, hands), faults, hands)
    return other if extended(other.clean, other.accepted).rms < FAR_LESS * left.rms else far


def _grown(clean: View, faults: Mapping[str, Fault], hands: Hands) -> Grown:
    far = grown(clean, faults, hands)
    return replace(far, accepted=_pruned(far.clean, far.accepted, hands))


def _dropped(final: View, known: Collection[str]) -> dict[str, Screened]:
    """Return the last word on effects that were accepted once and are not any more."""
    screenings = [
        screen(effect, final)
        for effect in EFFECTS
        if effect.against is None and effect.name not in known and not effect.untestable(final)
    ]
    return {found.effect.name: found for found in screenings if found is not None}


def _with_structure(outcome: Outcome, hands: Hands) -> Outcome:
    """Judge the envelope's own structure, with all causes at work."""
    final = outcome.final
    for effect in EFFECTS:
        if effect.against is None or effect.untestable(final):
            continue
        beside = any(cause.effect.resembles(effect) for cause in outcome.causes)
        hands.say(f"testing {effect.name.replace('_', ' ')}")
        judgement = judged_structure(effect, final)
        if judgement is None:
            continue
        found, structure = judgement
        if structure.speaks and _stands(structure, final, beside=beside):
            outcome = replace(outcome, causes=(*outcome.causes, structure))
            continue
        outcome = replace(outcome, screened={**outcome.screened, effect.name: found})
        if structure.speaks:
            outcome = replace(
                outcome,
                held_back=(*outcome.held_back, effect.name),
                rivals=_with_rival(outcome.rivals, effect),
            )
    return outcome


def _stands(structure: Judged, final: View, *, beside: bool) -> bool:
    """Tell whether structure may be named: what causes leave over looks like it as well.

    beside  whether one of the causes looks alike
    """
    if not beside:
        gain = structure.held.gain
        clear = gain > CLEARLY and part_explained(gain, final.rms, final.noise) > MOST
        return clear or final.rms < structure.effect.quiet * final.noise
    # and no half of it
    worth = structure.held.gain > structure.effect.worth or structure.settles_it
    return worth and final.rms < min(structure.effect.quiet, QUIET) * final.noise


def _with_rival(rivals: Rivals, effect: Effect) -> Rivals:
    """Say of causes that this structure may be what they are, or a part of them."""
    return {
        name: (*near, effect.name) if name in effect.rivals else near
        for name, near in rivals.items()
    }


def _without_slips(view: View, far: Grown, hands: Hands) -> Grown:
    """Take slips back, and out of the faults, where the causes leave less without them.

    A limit of the amplifier that a chirp meets from one instant on looks like one.
    """
    hands.say("asking whether a clock slipped at all")
    rest, faults = repaired(view, hands, but=SLIP)
    raw, again = with_tracks(far.clean, rest.tracks), list(far.accepted)
    for k, one in enumerate(far.accepted):
        if one.struck:
            continue
        others = [other for n, other in enumerate(again) if n != k]
        again[k], _ = refined(one, raw, others, finer=1)
    if extended(raw, again).rms > extended(far.clean, far.accepted).rms:
        return far
    return replace(far, clean=raw, accepted=tuple(again), faults=faults)


def _pruned(clean: View, accepted: Sequence[Accepted], hands: Hands) -> tuple[Accepted, ...]:
    """Take out, one by one, what is no longer worth its place beside the others.

    What was struck by jumps is worth its place behind them, whatever it is elsewhere.
    """
    accepted = tuple(accepted)
    while len(accepted) > 1 and not all(one.struck for one in accepted):
        hands.say("taking out what is not needed")
        whole = extended(clean, accepted).rms
        spare = [one for one in accepted if not one.struck]
        rests = [tuple(o for o in accepted if o is not one) for one in spare]
        views = hands.each(lambda rest: extended(clean, rest), rests)
        losses = [(1.0 - whole / view.rms) / asked(view) for view in views]
        if min(losses) >= WORTH:
            return accepted
        accepted = rests[losses.index(min(losses))]
    return accepted
