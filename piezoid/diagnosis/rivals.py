"""Rivals: what else could stand in the place of an accepted effect.

Each rival is refitted there with everything else in place. Where blocks do not lose surely less
with the accepted one (Vuong), the two are not separable on these recordings; where they surely
lose less with the rival, it takes the place.

Source: Vuong, Econometrica 57 (1989).
"""

from collections.abc import Sequence

from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.extended import Accepted
from piezoid.diagnosis.folds import surely
from piezoid.diagnosis.judgement import Judged, judged
from piezoid.diagnosis.refinement import begun, refined
from piezoid.diagnosis.screening import screen
from piezoid.diagnosis.view import View

NEAR = 0.5  # of the gain: what a rival's tangent must bring to be refitted
SEPARABLE = 1.96  # standard errors between two that are told apart
BETTER = 3.0  # standard errors from which a rival takes the place


def rivals_of(cause: Judged, clean: View, others: Sequence[Accepted]) -> tuple[Judged, ...]:
    """Return the rivals that these recordings do not tell from a cause, the best one first."""
    taken = {one.effect.name for one in others}
    tried = [
        _in_place(effect, cause, clean, others)
        for effect in EFFECTS
        if effect.name in cause.effect.rivals and effect.name not in taken
    ]
    near = [rival for rival in tried if rival is not None and _close(rival, cause)]
    return tuple(sorted(near, key=lambda rival: rival.held.rms))


def takes_the_place(rival: Judged, cause: Judged) -> bool:
    """Tell whether a rival is surely better than the effect that was accepted before it."""
    return rival.speaks and surely(cause.held.loss, rival.held.loss) > BETTER


def _close(rival: Judged, cause: Judged) -> bool:
    return rival.sound and surely(rival.held.loss, cause.held.loss) < SEPARABLE


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
    return judged(better, clean, others, seen=seen, view=view)
