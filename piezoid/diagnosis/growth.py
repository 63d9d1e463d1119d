"""Growth: one effect after another is accepted beside those accepted before.

Every round all effects are screened, the telling ones are refitted with the whole model, and the
one that leaves least is taken, unless slips of a clock, other pasts or one more state of
hysteresis leave less.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.judgement import Judged, judged
from piezoid.diagnosis.jumps import struck
from piezoid.diagnosis.knee import with_best_knee
from piezoid.diagnosis.memory import (
    OTHER_PASTS,
    does_as_well,
    with_best_habit,
    with_own_pasts,
)
from piezoid.diagnosis.refinement import begun, refined, refined_together
from piezoid.diagnosis.screening import Screened, screen
from piezoid.diagnosis.slips_instead import Instead, fault_beside, slips_instead, stand_better
from piezoid.diagnosis.view import View, with_free_memory, with_habit, with_knee, with_pasts

MOST_CAUSES = 5
SLIP = "timestamp_fault"
TELLING = 0.25  # of the best tangent's gain, from which an effect is refitted
LEAST_GAIN = 0.012
NEAR_TWIN = 0.9  # times its twin's gain, below which a refit will not help it
NOISY = 1.1  # times the sensor's noise: an error below it leaves nothing for structure
KNEE = 0.97  # of the error: what one more state of hysteresis must leave
LEFT_OVER = 0.3  # of a rival's share
CLEAR = 1.25  # times the noise: an error that is there
REST = 0.2  # of what is above the noise, in power: so little left is nobody else's
MOST = 0.4  # of the error, so much taken off, and
OVER_TWIN = 3.0  # times what its twin takes: a wrong shape for somebody's rest does no such thing
NEAR = 3.0  # times the least error left: how far a first refit may lie behind to be refined
FOREMOST = 0.8  # of the best tangent's gain, from which it may: one of a limit errs by factors
Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Grown:
    """How far a search has come.

    clean     the view of repaired tracks, with the pasts and the knee that were taken in
    accepted  effects, in the order in which they were found
    faults    of the data, by effect
    screened  the last word on each effect that was not accepted
    """

    clean: View
    accepted: tuple[Accepted, ...]
    faults: Mapping[str, Fault]
    screened: Mapping[str, Screened]


def grown(clean: View, faults: Mapping[str, Fault], progress: Progress) -> Grown:
    """Accept one effect after another until none is evidence."""
    progress("looking behind jumps of the drive")
    far = Grown(clean=clean, accepted=struck(clean), faults=faults, screened={})
    for _ in range(MOST_CAUSES + 2):
        view = extended(far.clean, far.accepted)
        named = {one.effect.name for one in far.accepted}
        far = replace(far, screened=_screened_all(view, named, progress))
        farther = _farther(far, view, progress)
        if farther is None:
            break
        far = farther
    return far


def _farther(far: Grown, view: View, progress: Progress) -> Grown | None:
    """Take in what leaves least: slips, a knee, other pasts, an effect; None where nothing does.

    view  with everything accepted, on which effects were screened
    """
    tried = _refitted(far, view, progress)
    best = _best(tried, far)
    least = best.view.rms if best else np.inf
    habit = with_best_habit(view)
    own = with_own_pasts(view, habit)
    bent = with_best_knee(view) if view.rms > NOISY * view.noise else view
    slips = _with_slips(far, view, best)
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
        return _with_slips_in_place(far, view)
    return replace(far, accepted=_settled(far.clean, [*far.accepted, best.accepted]))


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


def _refitted(far: Grown, without: View, progress: Progress) -> list[Judged]:
    """Return the telling effects with everything refitted, those that leave least at first.

    without  the view with everything accepted, on which they were screened
    """
    screenings = far.screened.values()
    best = max((found.total for found in screenings if found.sound), default=0.0)
    least = max(TELLING * best, LEAST_GAIN)
    telling = [f for f in screenings if f.total > least and f.sound and _above_twin(f)]
    first = []
    for found in telling:
        one = begun(found.effect, found.trial, float(found.held.coefficient[0]))
        first.append((extended(far.clean, [*far.accepted, one]).rms, one, found))
    closest = min((rms for rms, _, _ in first), default=0.0)
    finer = []
    for rms, one, found in first:
        if rms > NEAR * closest and found.total < FOREMOST * best:
            continue
        progress(f"refitting with {found.effect.name.replace('_', ' ')}")
        better, view = refined(one, far.clean, far.accepted)
        alone = judged(better, view, without, seen=found)
        finer.append(_together(alone, far, found))
    return finer


def _together(alone: Judged, far: Grown, seen: Screened) -> Judged:
    """Refine what was accepted alone for both, where these look alike, and the effect again.

    A delay that is none may be one then: beside a limit that follows a part of it, it differs from
    recording to recording. Where more is free than a time, that costs too much to hope for.
    """
    free = len(alone.accepted.free)
    moving = [one for one in far.accepted if one.free and not one.struck]
    alike = [one for one in moving if one.effect.resembles(alone.effect)]
    if not alike or not (free == 1 or (free and alone.sound)):
        return alone
    others = [one for one in far.accepted if one not in alike]
    better, view = refined_together([*alike, alone.accepted], far.clean, others)
    return judged(better[-1], view, alone.without, seen=seen)


def _best(tried: Sequence[Judged], far: Grown) -> Judged | None:
    """Return the effect that leaves least among those that are evidence."""
    own = [j for j in tried if j.speaks and not _left_over(j, far.clean, far.accepted)]
    return min(own, key=lambda j: j.held.rms, default=None)


def _above_twin(found: Screened) -> bool:
    """Tell whether a refit may help: tangents of what is looked for on a grid err by factors."""
    if found.twin is None or found.trial.free:
        return True
    return found.held.gain > NEAR_TWIN * found.twin.gain


def _left_over(found: Judged, clean: View, accepted: Sequence[Accepted]) -> bool:
    """Tell whether this may be what an accepted rival, not quite as modelled, leaves over.

    What takes a clear error down to the noise is no wrong shape for somebody's rest, nor is what
    takes most of it and far more than its unphysical twin.
    """
    noise, before = found.view.noise, found.without.rms
    if found.held.gain > MOST and found.twin and found.held.gain > OVER_TWIN * found.twin.gain:
        return False
    if before > CLEAR * noise and found.view.rms**2 - noise**2 < REST * (before**2 - noise**2):
        return False
    for one in accepted:
        if found.effect.name not in one.effect.rivals:
            continue
        rest = extended(clean, [other for other in accepted if other is not one])
        taken = sqrt(max(rest.rms**2 - found.without.rms**2, 0.0)) / 2.0
        if found.share < LEFT_OVER * taken:
            return True
    return False


def _settled(clean: View, accepted: Sequence[Accepted]) -> tuple[Accepted, ...]:
    """Refine the older effects beside the newest."""
    settled = list(accepted)
    for k, one in enumerate(accepted[:-1]):
        if one.free:
            rest = [other for other in settled if other is not one]
            settled[k], _ = refined(one, clean, rest, finer=1)
    return tuple(settled)
