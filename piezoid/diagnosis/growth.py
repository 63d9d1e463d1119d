"""Growth: one effect after another is accepted beside those accepted before.

Every round all effects are screened, the telling ones are refitted with the whole model, and the
one that leaves least is taken, unless slips of a clock, other pasts or one more state of
hysteresis leave less.
"""

from collections.abc import Callable, Sequence
from math import sqrt

import numpy as np

from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.judgement import Judged, judged
from piezoid.diagnosis.knee import with_best_knee
from piezoid.diagnosis.memory import OTHER_PASTS, with_own_pasts
from piezoid.diagnosis.refinement import begun, refined
from piezoid.diagnosis.screening import Screened, screen
from piezoid.diagnosis.slips_instead import Instead, slips_instead, stand_better
from piezoid.diagnosis.view import View, with_free_memory, with_knee, with_pasts

MOST_CAUSES = 5
SLIP = "timestamp_fault"
TELLING = 0.25  # of the best tangent's gain, from which an effect is refitted
LEAST_GAIN = 0.012
NEAR_TWIN = 0.9  # times its twin's gain, below which a refit will not help it
NOISY = 1.1  # times the sensor's noise: an error below it leaves nothing for structure
KNEE = 0.97  # of the error: what one more state of hysteresis must leave
LEFT_OVER = 0.3  # of a rival's share
NEAR = 3.0  # times the least error left: how far a first refit may lie behind to be refined
Progress = Callable[[str], None]
Grown = tuple[View, list[Accepted], dict[str, Screened]]


def grown(clean: View, faults: dict[str, Fault], progress: Progress) -> Grown:
    """Accept one effect after another; slips, other pasts or a knee first, where those leave less.

    Return the view with these pasts, the effects, and the last word on all others; slips that are
    found go to the faults.
    """
    accepted: list[Accepted] = []
    for _ in range(MOST_CAUSES + 2):
        view = extended(clean, accepted)
        silent = _screened_all(view, {one.effect.name for one in accepted}, progress)
        tried = _refitted(clean, accepted, view, list(silent.values()), progress)
        best = _best(tried, clean, accepted)
        least = best.view.rms if best else np.inf
        own = with_own_pasts(view)
        bent = with_best_knee(view) if view.rms > NOISY * view.noise else view
        slips = _slips(clean, accepted, view, best, again=SLIP in faults)
        if slips is not None and slips.view.rms < min(own.rms, bent.rms):
            clean = slips.clean
            faults[SLIP] = slips.fault.after(faults.get(SLIP))
        elif bent.rms < min(KNEE * view.rms, least, own.rms):
            clean = with_knee(clean, bent.envelope.knee)
        elif own.rms < min(OTHER_PASTS * view.rms, least):
            clean = with_free_memory(with_pasts(clean, own.envelope.turns))
        elif best is None:
            found = _in_place_of_one(clean, accepted, view, again=SLIP in faults)
            if found is None:
                break
            slips, accepted = found
            clean = slips.clean
            faults[SLIP] = slips.fault.after(faults.get(SLIP))
        else:
            accepted = _settled(clean, [*accepted, best.accepted])
    return clean, accepted, silent


def _slips(
    clean: View, accepted: Sequence[Accepted], view: View, best: Judged | None, *, again: bool
) -> Instead | None:
    """Return slips where they stand better than a filter, or than nothing."""
    if view.rms < NOISY * view.noise or (best and best.effect.passes is None):
        return None
    slips = slips_instead(clean, accepted, view)
    cause = best.view if best else None
    return slips if slips and stand_better(slips, view, cause, again=again) else None


def _in_place_of_one(
    clean: View, accepted: Sequence[Accepted], view: View, *, again: bool
) -> tuple[Instead, list[Accepted]] | None:
    """Return slips that stand better than a filter accepted before, and all others accepted."""
    for one in accepted:
        if one.effect.passes is None:
            continue
        rest = [other for other in accepted if other is not one]
        without = extended(clean, rest)
        slips = slips_instead(clean, rest, without)
        if slips and stand_better(slips, without, view, again=again):
            return slips, rest
    return None


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


def _refitted(
    clean: View,
    accepted: Sequence[Accepted],
    without: View,
    screenings: Sequence[Screened],
    progress: Progress,
) -> list[Judged]:
    """Return the telling effects with everything refitted, those that leave least at first.

    without  the view with everything accepted, on which they were screened
    """
    best = max((found.total for found in screenings if found.sound), default=0.0)
    least = max(TELLING * best, LEAST_GAIN)
    telling = [f for f in screenings if f.total > least and f.sound and _above_twin(f)]
    first = []
    for found in telling:
        one = begun(found.effect, found.trial, float(found.held.coefficient[0]))
        first.append((extended(clean, [*accepted, one]).rms, one, found))
    closest = min((rms for rms, _, _ in first), default=0.0)
    finer = []
    for rms, one, found in first:
        if rms > NEAR * closest:
            continue
        progress(f"refitting with {found.effect.name.replace('_', ' ')}")
        better, view = refined(one, clean, accepted)
        finer.append(judged(better, view, without, seen=found))
    return finer


def _best(tried: Sequence[Judged], clean: View, accepted: Sequence[Accepted]) -> Judged | None:
    """Return the effect that leaves least among those that are evidence."""
    own = [j for j in tried if j.speaks and not _left_over(j, clean, accepted)]
    return min(own, key=lambda j: j.held.rms, default=None)


def _above_twin(found: Screened) -> bool:
    return found.twin is None or found.held.gain > NEAR_TWIN * found.twin.gain


def _left_over(found: Judged, clean: View, accepted: Sequence[Accepted]) -> bool:
    """Tell whether this may be what an accepted rival, not quite as modelled, leaves over."""
    for one in accepted:
        if found.effect.name not in one.effect.rivals:
            continue
        rest = extended(clean, [other for other in accepted if other is not one])
        taken = sqrt(max(rest.rms**2 - found.without.rms**2, 0.0)) / 2.0
        if found.share < LEFT_OVER * taken:
            return True
    return False


def _settled(clean: View, accepted: Sequence[Accepted]) -> list[Accepted]:
    """Refine the older effects beside the newest."""
    accepted = list(accepted)
    for k, one in enumerate(accepted[:-1]):
        if one.free:
            rest = [other for other in accepted if other is not one]
            accepted[k], _ = refined(one, clean, rest, finer=1)
    return accepted
