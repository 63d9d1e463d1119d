"""Model comparison: which confounded effect could stand in the place of a selected one.

Each is refitted in its place with everything else at work. Where blocks do not lose significantly
less with the selected effect (Vuong), the two are not separable on these recordings. Blocks may
be sure of no more than a drive that turned between two samples, so a small part of what a cause
explains separates nothing.

Source: Vuong, Econometrica 57 (1989).
"""

from collections.abc import Sequence

from piezoid.diagnosis.blocked_regression import paired_z
from piezoid.diagnosis.candidate import Candidate, judged
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.refinement import initial_guess, refined
from piezoid.diagnosis.refitted_view import SelectedEffect, extended
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.step_responses import behind_jumps
from piezoid.formatting import words
from piezoid.numerics.executor import SERIAL, Executor

NEAR = 0.5  # of the gain: what a confounded effect's tangent must bring to be refitted
SEPARABLE = 1.96  # standard errors between two that are told apart
ALIKE = 0.02  # of what a cause explains, and of what it leaves: so close is no difference

Confounded = dict[str, tuple[str, ...]]


def compare_models(
    clean: View, selected: Sequence[SelectedEffect], executor: Executor
) -> tuple[list[Candidate], Confounded, list[Candidate]]:
    """Judge every selected effect, and name the effects that do as well.

    What has no name beside all others goes, the least of it first; it is returned last.
    """
    selected = list(selected)
    dismissed: list[Candidate] = []
    while True:
        causes, confounded = _compare_each(clean, selected, executor)
        mute = [cause for cause in causes if not cause.has_a_name]
        if not mute:
            return causes, confounded, dismissed
        least = min(mute, key=lambda cause: cause.cv.gain)
        dismissed.append(least)
        selected = [cause.selected for cause in causes if cause is not least]


def _compare_each(
    clean: View, selected: list[SelectedEffect], executor: Executor
) -> tuple[list[Candidate], Confounded]:
    causes, near = [], {}
    for k, one in enumerate(selected):
        executor.report(f"comparing {words(one.effect.name)} with confounded effects")
        others = [other for n, other in enumerate(selected) if n != k]
        there, beside = _where_seen(one, clean, others)
        # judged once more, refined beside all others
        better, view = refined(one, there, beside, finer=1)
        without = extended(there, beside)
        seen = score_test(one.effect, without)
        assert seen is not None
        cause = judged(better, view, without, seen=seen)
        confounded = confounded_with(cause, there, beside, executor)
        causes.append(cause)
        near[cause.effect.name] = tuple(alternative.effect.name for alternative in confounded)
    return causes, near


def _where_seen(
    one: SelectedEffect, clean: View, others: list[SelectedEffect]
) -> tuple[View, list[SelectedEffect]]:
    """Return where an effect is judged, and which others are yet to be put to work there."""
    jumps = behind_jumps(extended(clean, others)) if one.from_jumps else None
    if jumps is None:
        return clean, others
    return jumps, [other for other in others if other.effect.drive_filter is None]


def confounded_with(
    cause: Candidate, clean: View, others: Sequence[SelectedEffect], executor: Executor = SERIAL
) -> tuple[Candidate, ...]:
    """Return the effects that these recordings do not separate from a cause, the best first."""
    taken = {one.effect.name for one in others}
    asked = [
        e for e in every_effect() if e.name in cause.effect.confounded and e.name not in taken
    ]
    tried = executor.map(lambda effect: _in_place(effect, cause, clean, others), asked)
    near = [
        alternative
        for alternative in tried
        if alternative is not None and is_confounded(alternative, cause)
    ]
    return tuple(sorted(near, key=lambda alternative: alternative.cv.rms))


def is_confounded(alternative: Candidate, cause: Candidate) -> bool:
    """Tell whether these recordings do not tell a confounded effect from a cause."""
    if not alternative.physical:
        # physics does not allow it, and yet it leaves less: something else is not what it seems
        return alternative.cv.rms < cause.cv.rms
    worse = alternative.cv.rms**2 - cause.cv.rms**2
    explained = cause.without.rms**2 - cause.cv.rms**2
    if worse < ALIKE * explained and alternative.cv.rms < (1.0 + ALIKE) * cause.cv.rms:
        return True
    return paired_z(alternative.cv.loss, cause.cv.loss) < SEPARABLE


def _in_place(
    effect: Effect, cause: Candidate, clean: View, others: Sequence[SelectedEffect]
) -> Candidate | None:
    if effect.trials is None or effect.structural is not None or effect.untestable(cause.without):
        return None
    seen = score_test(effect, cause.without)
    if seen is None or seen.total_gain < NEAR * cause.cv.gain:
        return None
    if not seen.physical and seen.separable:
        return None
    one = initial_guess(effect, seen.trial, float(seen.cv.coefficient[0]))
    better, view = refined(one, clean, others, finer=1)
    return judged(better, view, cause.without, seen=seen)
