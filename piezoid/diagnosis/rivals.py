"""Rivals: what else could stand in the place of an accepted effect.

Each rival is refitted there with everything else in place. Where blocks do not lose surely less
with the accepted one (Vuong), the two are not separable on these recordings; where they surely
lose less with the rival, it takes the place. And blocks may be sure of what is no more than a
drive that turned between two samples: so little of what a cause explains separates nothing.

Source: Vuong, Econometrica 57 (1989).
"""

from collections.abc import Sequence

from piezoid.diagnosis.blocks import surely
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.judgement import Judged, judged
from piezoid.diagnosis.jumps import behind_jumps
from piezoid.diagnosis.refinement import begun, refined
from piezoid.diagnosis.screening import screen
from piezoid.diagnosis.view import View
from piezoid.numerics.hands import ALONE, Hands

NEAR = 0.5  # of the gain: what a rival's tangent must bring to be refitted
SEPARABLE = 1.96  # standard errors between two that are told apart
ALIKE = 0.02  # of what a cause explains, and of what it leaves: so close is no difference
BETTER = 3.0  # standard errors from which a rival takes the place,
LIKELIER = 1.0  # and one that can do no more than what stands there

Rivals = dict[str, tuple[str, ...]]


def told_apart(
    clean: View, accepted: Sequence[Accepted], hands: Hands
) -> tuple[list[Judged], Rivals]:
    """Judge every accepted effect, or the rival that takes its place, and name who is as good.

    What no longer speaks beside all others goes, the least of it first.
    """
    accepted = list(accepted)
    while True:
        causes, rivals = _each(clean, accepted, hands)
        mute = [cause for cause in causes if not cause.speaks]
        if not mute:
            return causes, rivals
        least = min(mute, key=lambda cause: cause.held.gain)
        accepted = [cause.accepted for cause in causes if cause is not least]


def _each(clean: View, accepted: list[Accepted], hands: Hands) -> tuple[list[Judged], Rivals]:
    accepted, causes, near = list(accepted), [], {}
    for k, one in enumerate(accepted):
        hands.say(f"telling {one.effect.name.replace('_', ' ')} from its rivals")
        others = [other for n, other in enumerate(accepted) if n != k]
        there, beside = _where_seen(one, clean, others)
        cause = _cause(there, beside, one)
        rivals = rivals_of(cause, there, beside, hands)
        if rivals and takes_the_place(rivals[0], cause):
            accepted[k] = rivals[0].accepted
            cause, rivals = rivals[0], rivals_of(rivals[0], there, beside, hands)
        causes.append(cause)
        near[cause.effect.name] = tuple(rival.effect.name for rival in rivals)
    return causes, near


def _where_seen(one: Accepted, clean: View, others: list[Accepted]) -> tuple[View, list[Accepted]]:
    """Return where an effect is judged, and which others are yet to be put to work there."""
    jumps = behind_jumps(extended(clean, others)) if one.struck else None
    if jumps is None:
        return clean, others
    return jumps, [other for other in others if other.effect.drive is None]


def _cause(clean: View, others: Sequence[Accepted], one: Accepted) -> Judged:
    """Judge an accepted effect once more, refined beside all others."""
    better, view = refined(one, clean, others, finer=1)
    without = extended(clean, others)
    seen = screen(one.effect, without)
    assert seen is not None
    return judged(better, view, without, seen=seen)


def rivals_of(
    cause: Judged, clean: View, others: Sequence[Accepted], hands: Hands = ALONE
) -> tuple[Judged, ...]:
    """Return the rivals that these recordings do not tell from a cause, the best one first."""
    taken = {one.effect.name for one in others}
    asked = [e for e in EFFECTS if e.name in cause.effect.rivals and e.name not in taken]
    tried = hands.each(lambda effect: _in_place(effect, cause, clean, others), asked)
    near = [rival for rival in tried if rival is not None and is_close(rival, cause)]
    return tuple(sorted(near, key=lambda rival: rival.held.rms))


def takes_the_place(rival: Judged, cause: Judged) -> bool:
    """Tell whether a rival is surely better than the effect that was accepted before it.

    Of two filters with as many parameters, neither of which surely is, the likelier one stands:
    the other came first because of what was found only after it.
    """
    filters = rival.effect.passes is not None and cause.effect.passes is not None
    as_free = filters and len(rival.accepted.free) == len(cause.accepted.free)
    least = LIKELIER if as_free else BETTER
    return rival.speaks and surely(cause.held.loss, rival.held.loss) > least


def is_close(rival: Judged, cause: Judged) -> bool:
    """Tell whether these recordings do not tell a rival from a cause."""
    if not rival.sound:
        # physics does not allow it, and yet it leaves less: something else is not what it seems
        return rival.held.rms < cause.held.rms
    worse = rival.held.rms**2 - cause.held.rms**2
    explained = cause.without.rms**2 - cause.held.rms**2
    if worse < ALIKE * explained and rival.held.rms < (1.0 + ALIKE) * cause.held.rms:
        return True
    return surely(rival.held.loss, cause.held.loss) < SEPARABLE


def _in_place(
    effect: Effect, cause: Judged, clean: View, others: Sequence[Accepted]
) -> Judged | None:
    if effect.trials is None or effect.against is not None or effect.untestable(cause.without):
        return None
    seen = screen(effect, cause.without)
    if seen is None or not seen.sound or seen.total < NEAR * cause.held.gain:
        return None
    one = begun(effect, seen.trial, float(seen.held.coefficient[0]))
    better, view = refined(one, clean, others, finer=1)
    return judged(better, view, cause.without, seen=seen)
