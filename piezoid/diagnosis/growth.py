"""Growth: one effect after another is accepted beside those accepted before.

Every round all effects are screened, the telling ones are refitted with the whole model, and the
one that leaves least is taken, unless slips of a clock, other pasts or one more state of
hysteresis leave less. Where nothing is evidence alone, two that look alike may be together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.candidates import Beside, best_of, refitted
from piezoid.diagnosis.effect import BETWEEN, Effect, Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.elsewhere import placed_elsewhere
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.judgement import Judged
from piezoid.diagnosis.jumps import struck
from piezoid.diagnosis.knee import with_best_knee
from piezoid.diagnosis.memory import (
    OTHER_PASTS,
    does_as_well,
    with_best_habit,
    with_own_pasts,
)
from piezoid.diagnosis.pairs import pair_in_place, pair_of
from piezoid.diagnosis.refinement import refined
from piezoid.diagnosis.screening import Screened, screen
from piezoid.diagnosis.slips_instead import Instead, fault_beside, slips_instead, stand_better
from piezoid.diagnosis.view import View, with_free_memory, with_habit, with_knee, with_pasts
from piezoid.numerics.hands import Hands

MOST_CAUSES = 5
SLIP = "timestamp_fault"
NOISY = 1.1  # times the sensor's noise: an error below it leaves nothing for structure
KNEE = 0.97  # of the error: what one more state of hysteresis must leave


@dataclass(frozen=True, kw_only=True, eq=False)
class Grown:
    """How far a search has come.

    clean     the view of repaired tracks, with the pasts and the knee that were taken in
    accepted  effects, in the order in which they were found
    faults    of the data, by effect
    screened  the last word on each effect that was not accepted, and where it comes ``BETWEEN``
    """

    clean: View
    accepted: tuple[Accepted, ...]
    faults: Mapping[str, Fault]
    screened: Mapping[str, Screened]


def grown(clean: View, faults: Mapping[str, Fault], hands: Hands) -> Grown:
    """Accept one effect after another until none is evidence."""
    hands.say("looking behind jumps of the drive")
    far = Grown(clean=clean, accepted=struck(clean), faults=faults, screened={})
    for _ in range(MOST_CAUSES + 2):
        view = extended(far.clean, far.accepted)
        named = {one.effect.name for one in far.accepted}
        far = replace(far, screened=_screened_all(view, named, hands))
        farther = _farther(far, view, hands)
        if farther is None:
            break
        far = farther
    return far


def _farther(far: Grown, view: View, hands: Hands) -> Grown | None:
    """Take in what leaves least: slips, a knee, other pasts, an effect; None where nothing does.

    view  with everything accepted, on which effects were screened
    """
    beside = Beside(clean=far.clean, accepted=far.accepted, view=view)
    tried = refitted(far.screened.values(), beside, hands)
    best = best_of(tried, beside)
    least = best.view.rms if best else np.inf
    moved = placed_elsewhere(beside, best)
    if moved is not None:
        return replace(far, accepted=moved)
    habit = with_best_habit(view, hands)
    own, (bent, slips) = hands.both(
        lambda: with_own_pasts(view, habit), lambda: _bent_and_slipped(far, view, best)
    )
    if slips is not None and slips[1] < min(own.rms, bent.rms):
        return slips[0]
    if bent.rms < min(KNEE * view.rms, least, own.rms):
        return replace(far, clean=with_knee(far.clean, bent.envelope.knee))
    # what is evident, and too small to be named, is no reason to believe in other pasts
    least = min([least, *(one.view.rms for one in tried if one.is_evidence)])
    if habit.rms < min(OTHER_PASTS * view.rms, least) and does_as_well(habit, own, view):
        return replace(far, clean=with_habit(far.clean, habit.envelope.turns))
    if own.rms < min(OTHER_PASTS * view.rms, least):
        return replace(far, clean=with_free_memory(with_pasts(far.clean, own.envelope.turns)))
    if best is None:
        return _with_slips_in_place(far, view) or _with_pair(far, beside, tried, hands)
    return replace(far, accepted=_settled(far.clean, [*far.accepted, best.accepted]))


def _bent_and_slipped(
    far: Grown, view: View, best: Judged | None
) -> tuple[View, tuple[Grown, float] | None]:
    """Return the view with one more state of hysteresis, and what slips come to."""
    bent = with_best_knee(view) if view.rms > NOISY * view.noise else view
    return bent, _with_slips(far, view, best)


def _with_pair(far: Grown, beside: Beside, tried: Sequence[Judged], hands: Hands) -> Grown | None:
    """Take in two effects at once that one of them, or both, stood for alone."""
    hands.say("looking for two that are taken for one")
    pair = pair_of(tried, beside, hands)
    accepted = (*beside.accepted, *pair) if pair else pair_in_place(beside, hands)
    return replace(far, accepted=accepted) if accepted else None


def _with_slips(far: Grown, view: View, best: Judged | None) -> tuple[Grown, float] | None:
    """Take in slips where they stand better than a filter, or than nothing; and the error left."""
    if view.rms < NOISY * view.noise or (best and best.effect.passes is None):
        return None
    slips = slips_instead(far.clean, far.accepted, view)
    cause = best.view if best else None
    if slips is None or not stand_better(slips, view, cause, far.faults.get(SLIP)):
        return None
    fault = fault_beside(slips, best.effect.name, best.view) if best else slips.fault
    return _slipped(far, slips, fault, far.accepted), slips.view.rms


def _with_slips_in_place(far: Grown, view: View) -> Grown | None:
    """Take in slips that stand better than a filter accepted before, in its place."""
    for one in far.accepted:
        if one.effect.passes is None:
            continue
        rest = tuple(other for other in far.accepted if other is not one)
        without = extended(far.clean, rest)
        slips = slips_instead(far.clean, rest, without)
        if slips and stand_better(slips, without, view, far.faults.get(SLIP)):
            return _slipped(far, slips, fault_beside(slips, one.effect.name, view), rest)
    return None


def _slipped(far: Grown, slips: Instead, fault: Fault, accepted: tuple[Accepted, ...]) -> Grown:
    faults = {**far.faults, SLIP: fault.after(far.faults.get(SLIP))}
    return replace(far, clean=slips.clean, accepted=accepted, faults=faults)


def _screened_all(view: View, named: set[str], hands: Hands) -> dict[str, Screened]:
    def screened(effect: Effect) -> Screened | None:
        hands.say(f"testing {effect.name.replace('_', ' ')}")
        return screen(effect, view)

    others = [e for e in EFFECTS if e.against is None and e.name not in named]
    others = [effect for effect in others if not effect.untestable(view)]
    between = {f"{e.name} {BETWEEN}": e.between for e in others if e.between is not None}
    asked = {**{effect.name: effect for effect in others}, **between}
    found = zip(asked, hands.each(screened, asked.values()), strict=True)
    return {name: one for name, one in found if one is not None}


def _settled(clean: View, accepted: Sequence[Accepted]) -> tuple[Accepted, ...]:
    """Refine the older effects beside the newest."""
    settled = list(accepted)
    for k, one in enumerate(accepted[:-1]):
        if one.free:
            rest = [other for other in settled if other is not one]
            settled[k], _ = refined(one, clean, rest, finer=1)
    return tuple(settled)
