"""The search for causes: faults first, then one effect at a time, then what is not needed goes.

All effects are screened by their tangents; the telling ones are refitted with the whole model, and
the one that then leaves least is accepted, if it is sure, physical and clearly better than its
unphysical twins. Everything is screened again beside it. At the end each effect must still be
worth its place with all others there, and a rival that does better in its place takes it.
"""

from dataclasses import dataclass

from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.growth import SLIP, Progress, grown
from piezoid.diagnosis.judgement import Judged, structure_of
from piezoid.diagnosis.refinement import refined
from piezoid.diagnosis.repair import repaired
from piezoid.diagnosis.rivals import Rivals, told_apart
from piezoid.diagnosis.screening import Screened, screen
from piezoid.diagnosis.view import View, with_tracks

WORTH = 0.02  # of the rms: what removing a cause must lose
CLEARLY = 0.35  # of the error: what structure takes off that nothing else here looks like
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
    """

    first: View
    clean: View
    final: View
    faults: dict[str, Fault]
    causes: tuple[Judged, ...]
    rivals: Rivals
    screened: dict[str, Screened]
    held_back: tuple[str, ...] = ()


def search(view: View, progress: Progress = lambda _: None) -> Outcome:
    """Find the causes of what the envelope cannot follow."""
    clean, faults = repaired(view, progress)
    clean, accepted, silent = grown(clean, faults, progress)
    accepted = _pruned(clean, accepted, progress)
    if SLIP in faults and accepted:
        progress("asking whether a clock slipped at all")
        clean, accepted = _without_slips(view, clean, accepted, faults)
    causes, rivals = told_apart(clean, accepted, progress)
    accepted = [cause.accepted for cause in causes]
    final = extended(clean, accepted)
    held_back = []
    for effect in EFFECTS:
        if effect.against is None or effect.untestable(final):
            continue
        progress(f"testing {effect.name.replace('_', ' ')}")
        found = screen(effect, final)
        if found is None:
            continue
        structure = structure_of(found, final)
        if structure.speaks and _stands(structure, final, beside=bool(accepted)):
            causes.append(structure)
            continue
        silent[effect.name] = found
        if structure.speaks:
            held_back.append(effect.name)
            rivals = _with_rival(rivals, effect)
    return Outcome(
        first=view,
        clean=clean,
        final=final,
        faults=faults,
        causes=tuple(causes),
        rivals=rivals,
        screened=silent,
        held_back=tuple(held_back),
    )


def _stands(structure: Judged, final: View, *, beside: bool) -> bool:
    """Tell whether structure may be named: what causes leave over looks like it as well.

    beside  whether causes were found
    """
    if structure.held.gain > CLEARLY and not beside:
        return True
    quiet = min(structure.effect.quiet, QUIET) if beside else structure.effect.quiet
    return final.rms < quiet * final.noise


def _with_rival(rivals: Rivals, effect: Effect) -> Rivals:
    """Say of causes that this structure may be what they are, or a part of them."""
    return {
        name: (*near, effect.name) if name in effect.rivals else near
        for name, near in rivals.items()
    }


def _without_slips(
    view: View, clean: View, accepted: list[Accepted], faults: dict[str, Fault]
) -> tuple[View, list[Accepted]]:
    """Take slips back, and out of the faults, where the causes leave less without them.

    A limit of the amplifier that a chirp meets from one instant on looks like one.
    """
    raw = with_tracks(clean, view.tracks)
    again = list(accepted)
    for k, one in enumerate(accepted):
        rest = [other for n, other in enumerate(again) if n != k]
        again[k], _ = refined(one, raw, rest, finer=1)
    if extended(raw, again).rms > extended(clean, accepted).rms:
        return clean, accepted
    del faults[SLIP]
    return raw, again


def _pruned(clean: View, accepted: list[Accepted], progress: Progress) -> list[Accepted]:
    """Take out, one by one, what is no longer worth its place beside the others."""
    while len(accepted) > 1:
        progress("taking out what is not needed")
        whole = extended(clean, accepted).rms
        losses = []
        for k in range(len(accepted)):
            rest = [other for n, other in enumerate(accepted) if n != k]
            losses.append(1.0 - whole / extended(clean, rest).rms)
        if min(losses) >= WORTH:
            return accepted
        del accepted[losses.index(min(losses))]
    return accepted
