"""Model comparison: find the confounded effects that could replace a selected effect.

Each confounded effect is refitted instead of the selected effect, with all others in the model.
The two are not separable on these recordings if the loss over blocks is not significantly smaller
with the selected effect (Vuong). The difference between two interpolations of the drive may be
significant, so a small difference does not separate effects either.

Source: Vuong, Econometrica 57 (1989).
"""

from collections.abc import Sequence

from piezoid.diagnosis.blocked_regression import paired_z
from piezoid.diagnosis.candidate import Candidate, evaluate
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import every_effect
from piezoid.diagnosis.refinement import initial_guess, refine
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.step_responses import step_response_view
from piezoid.formatting import words
from piezoid.numerics.executor import Executor

MIN_TANGENT_GAIN = 0.5  # of the effect's gain, by a confounded effect that is refitted
SEPARABLE = 1.96  # standard errors between two effects
MIN_DIFFERENCE = 0.02  # of the explained and of the remaining error, to separate two effects

Confounded = dict[str, tuple[str, ...]]  # names of effects that could replace an effect, by name


def compare_models(
    clean: View, selected: Sequence[SelectedEffect], executor: Executor
) -> tuple[list[Candidate], Confounded, list[Candidate]]:
    """Evaluate every selected effect beside the others, and find its confounded effects.

    Effects that may not be named are dismissed one by one, the smallest gain first.

    Returns effects that may be named, their confounded effects, and the dismissed effects.
    """
    selected = list(selected)
    dismissed: list[Candidate] = []
    while True:
        candidates, confounded = _compare_each(clean, selected, executor)
        rejected = [c for c in candidates if not c.may_be_named]
        if not rejected:
            return candidates, confounded, dismissed
        weakest = min(rejected, key=lambda candidate: candidate.cv.gain)
        dismissed.append(weakest)
        selected = [c.selected for c in candidates if c is not weakest]


def _compare_each(
    clean: View, selected: Sequence[SelectedEffect], executor: Executor
) -> tuple[list[Candidate], Confounded]:
    candidates, confounded = [], {}
    for k, effect in enumerate(selected):
        name = effect.effect.name
        executor.report(f"comparing {words(name)} with confounded effects")
        view, remaining = _evaluation_view(effect, clean, [*selected[:k], *selected[k + 1 :]])
        refined, with_effect = refine(effect, view, remaining, finer=1)
        without = with_effects(view, remaining)
        test = score_test(effect.effect, without)
        assert test is not None
        candidate = evaluate(refined, with_effect, without, test=test)
        alternatives = _find_confounded(candidate, view, remaining, executor)
        candidates.append(candidate)
        confounded[name] = tuple(alternative.effect.name for alternative in alternatives)
    return candidates, confounded


def _evaluation_view(
    effect: SelectedEffect, clean: View, remaining: list[SelectedEffect]
) -> tuple[View, list[SelectedEffect]]:
    """Return the view on which an effect is evaluated, and the other effects to add to it.

    An effect detected in step responses is evaluated on these, where the drive is filtered.
    """
    if not effect.from_jumps:
        return clean, remaining
    step_responses = step_response_view(with_effects(clean, remaining))
    if step_responses is None:
        return clean, remaining
    return step_responses, [other for other in remaining if other.effect.drive_filter is None]


def _find_confounded(
    candidate: Candidate,
    clean: View,
    remaining: Sequence[SelectedEffect],
    executor: Executor,
) -> tuple[Candidate, ...]:
    """Return the effects that could replace a selected effect, the smallest error first."""
    in_model = {effect.effect.name for effect in remaining}
    alternatives = executor.map(
        lambda effect: _evaluate_alternative(effect, candidate, clean, remaining),
        [
            effect
            for effect in every_effect()
            if effect.name in candidate.effect.confounded and effect.name not in in_model
        ],
    )
    confounded = [
        alternative
        for alternative in alternatives
        if alternative is not None and is_confounded(alternative, candidate)
    ]
    return tuple(sorted(confounded, key=lambda alternative: alternative.cv.rms))


def _evaluate_alternative(
    effect: Effect, candidate: Candidate, clean: View, remaining: Sequence[SelectedEffect]
) -> Candidate | None:
    """Refit a confounded effect instead of a selected one; None if its gain is too small."""
    without = candidate.without
    if effect.trials is None or effect.structural is not None or effect.untestable(without):
        return None
    test = score_test(effect, without)
    if test is None or test.total_gain < MIN_TANGENT_GAIN * candidate.cv.gain:
        return None
    if test.separable and not test.physical:
        return None
    guess = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
    refined, view = refine(guess, clean, remaining, finer=1)
    return evaluate(refined, view, without, test=test)


def is_confounded(alternative: Candidate, candidate: Candidate) -> bool:
    """Tell whether the recordings cannot separate an alternative from a selected effect."""
    if not alternative.physical:
        # an impossible effect with a smaller error raises doubts about the selected effect
        return alternative.cv.rms < candidate.cv.rms
    excess = alternative.cv.rms**2 - candidate.cv.rms**2
    explained = candidate.without.rms**2 - candidate.cv.rms**2
    is_small = excess < MIN_DIFFERENCE * explained
    if is_small and alternative.cv.rms < (1.0 + MIN_DIFFERENCE) * candidate.cv.rms:
        return True
    return paired_z(alternative.cv.loss, candidate.cv.loss) < SEPARABLE
