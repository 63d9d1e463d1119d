"""The search for causes: faults first, then one effect at a time, then what is not needed goes.

Accepted is the effect with the largest gain on rows left out, among those that are sure, physical
and clearly better than their unphysical twins; everything is screened again beside it. At the end
each effect must still be worth its place with all others there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.screening import Screened, refined, screen, screened
from piezoid.diagnosis.view import View, with_tracks

MOST_CAUSES = 5
MOST_REPAIRS = 3
WORTH = 0.02  # of the rms on rows left out: what removing a cause must lose
Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cause:
    """An accepted effect as it stands at the end.

    found    what it brings to a view that has all others
    without  that view
    """

    accepted: Accepted
    found: Screened
    without: View


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a search came to.

    first     the view of the raw recordings
    clean     with faults repaired
    final     with all causes at work
    faults    by effect
    causes    one for each accepted effect
    screened  the last word on each effect that was not accepted
    """

    first: View
    clean: View
    final: View
    faults: dict[str, Fault]
    causes: tuple[Cause, ...]
    screened: dict[str, Screened]


def search(view: View, progress: Progress = lambda _: None) -> Outcome:
    """Find the causes of what the envelope cannot follow."""
    clean, faults = _repaired(view, progress)
    accepted, silent = _grown(clean, progress)
    accepted = _pruned(clean, accepted, progress)
    final = extended(clean, accepted)
    causes = [_cause(clean, accepted, one) for one in accepted]
    for effect in EFFECTS:
        if effect.against is None or effect.untestable(final):
            continue
        progress(f"testing {effect.name.replace('_', ' ')}")
        found = screen(effect, final)
        # what another cause leaves over looks like structure: then nothing is said of structure
        if found is not None and found.speaks and not accepted:
            causes.append(Cause(accepted=_accepted(found), found=found, without=final))
        elif found is not None:
            silent[effect.name] = found
    return Outcome(
        first=view,
        clean=clean,
        final=final,
        faults=faults,
        causes=tuple(causes),
        screened=silent,
    )


def _repaired(view: View, progress: Progress) -> tuple[View, dict[str, Fault]]:
    faults: dict[str, Fault] = {}
    for effect in EFFECTS:
        if effect.fault is None:
            continue
        for _ in range(MOST_REPAIRS):
            progress(f"looking for {effect.name.replace('_', ' ')}")
            fault = effect.fault(view)
            if fault is None:
                break
            faults.setdefault(effect.name, fault)
            if all(a is b for a, b in zip(fault.tracks, view.tracks, strict=True)):
                break
            view = with_tracks(view, fault.tracks)
    return view, faults


def _grown(clean: View, progress: Progress) -> tuple[list[Accepted], dict[str, Screened]]:
    """Accept one effect after another; return them, and the last word on all others."""
    accepted: list[Accepted] = []
    silent: dict[str, Screened] = {}
    for _ in range(MOST_CAUSES):
        view = extended(clean, accepted)
        silent |= _screened_all(view, {one.effect.name for one in accepted}, progress)
        named = {one.effect.name for one in accepted}
        best = _best(view, [f for name, f in silent.items() if name not in named])
        if best is None:
            break
        accepted = [*accepted, _accepted(best)]
    return accepted, silent


def _screened_all(view: View, named: set[str], progress: Progress) -> dict[str, Screened]:
    found = {}
    for effect in EFFECTS:
        if effect.against is not None or effect.name in named or effect.untestable(view):
            continue
        progress(f"testing {effect.name.replace('_', ' ')}")
        screening = screen(effect, view)
        if screening is not None:
            found[effect.name] = screening
    return found


def _best(view: View, screenings: Sequence[Screened]) -> Screened | None:
    speaking = [found for found in screenings if found.sound and found.held.gain > 0.0]
    speaking.sort(key=lambda found: found.held.gain, reverse=True)
    # near the top the finer parameters decide, and they must be sought before it is said
    finer = [refined(found, view) for found in speaking if _near(found, speaking[0])]
    finer = [found for found in finer if found.speaks]
    return max(finer, key=lambda found: found.held.gain, default=None)


def _near(found: Screened, best: Screened) -> bool:
    return found.held.gain > 0.45 * best.held.gain and found.held.gain > 0.015


def _accepted(found: Screened) -> Accepted:
    return Accepted(effect=found.effect, trial=found.trial)


def _pruned(clean: View, accepted: list[Accepted], progress: Progress) -> list[Accepted]:
    """Take out, one by one, what is no longer worth its place beside the others."""
    while len(accepted) > 1:
        progress("taking out what is not needed")
        whole = extended(clean, accepted).null.held_out_rms
        losses = []
        for one in accepted:
            rest = [other for other in accepted if other is not one]
            losses.append(1.0 - whole / extended(clean, rest).null.held_out_rms)
        if min(losses) >= WORTH:
            return accepted
        accepted = [one for k, one in enumerate(accepted) if k != losses.index(min(losses))]
    return accepted


def _cause(clean: View, accepted: Sequence[Accepted], one: Accepted) -> Cause:
    """Judge an accepted effect once more, refined beside all others."""
    without = extended(clean, [other for other in accepted if other is not one])
    assert one.effect.columns is not None
    trial = replace(one.trial, columns=one.effect.columns(without, one.parameters))
    found = refined(screened(one.effect, without.null, [trial]), without)
    return Cause(accepted=_accepted(found), found=found, without=without)
