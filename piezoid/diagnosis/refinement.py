"""Refine the nonlinear parameters of an effect, with the whole model refitted at every step.

Tangents only give start values; the error with the effect in the model decides. The parameters
are searched one after the other with decreasing steps.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View

STEP_FRACTIONS = (1.0, 0.3, 0.1, 0.03)  # of a parameter's width
MAX_STEPS = 6
MIN_VERTEX = 0.05  # of a step: a vertex nearer to its centre is not tried
MAX_EXTRAPOLATION = 5.0  # of the change in one round
MIN_GAIN = 5e-4  # of the error, by one step

Refined = tuple[SelectedEffect, View]  # an effect, and the view with it and all others


def initial_guess(effect: Effect, trial: Trial, coefficient: float) -> SelectedEffect:
    """Return an effect with the parameters of its best tangent.

    For a filter of the response the time constant is multiplied by the coefficient.
    """
    parameters = dict(trial.parameters)
    if effect.response_filter is not None:
        factor = float(np.clip(coefficient, 0.2, 5.0))
        parameters |= {name: parameters[name] * factor for name in trial.free}
    return SelectedEffect(
        effect=effect, parameters=parameters, free=trial.free, limits=trial.limits
    )


def refine(
    effect: SelectedEffect,
    clean: View,
    selected: Sequence[SelectedEffect],
    *,
    finer: int = 0,
    start: View | None = None,
) -> Refined:
    """Refine the parameters of an effect beside selected effects by coordinate search.

    finer  number of coarse steps to skip, for parameters near the minimum
    start  a view with similar effects, to start the rounds of ``with_effects``
    """
    best = effect, _settled_view(clean, [*selected, effect], start)
    for fraction in STEP_FRACTIONS[finer:]:
        for name in effect.free:
            best = _line_search(best, clean, selected, name, fraction)
    return best


def refine_together(
    effects: Sequence[SelectedEffect], clean: View, selected: Sequence[SelectedEffect]
) -> tuple[list[SelectedEffect], View]:
    """Refine the parameters of several effects together.

    Refining one effect after the other is slow in a curved valley of the error: a limit that was
    fitted without the lag behind it absorbs a part of the lag. The change of one round is
    therefore extrapolated to the minimum of a parabola.

    Source: Hooke & Jeeves, J. ACM 8 (1961), the pattern move.
    """
    refined, start = list(effects), _settled_view(clean, [*selected, *effects], None)
    view = start
    for k, effect in enumerate(effects):
        remaining = [*selected, *refined[:k], *refined[k + 1 :]]
        refined[k], view = refine(effect, clean, remaining, finer=1, start=view)

    def extrapolate(length: float) -> tuple[list[SelectedEffect], View]:
        """Change the effects further by a multiple of their change in one round."""
        trial = []
        for first, second in zip(effects, refined, strict=True):
            parameters = dict(second.parameters)
            for name, width in second.free.items():
                a, b = first.parameters[name], second.parameters[name]
                value = b * (b / a) ** length if width > 1.0 else b + length * (b - a)
                parameters[name] = _limited(second, name, value)
            trial.append(replace(second, parameters=parameters))
        return trial, with_effects(clean, [*selected, *trial], view)

    doubled = extrapolate(1.0)
    # the minimum of the parabola through the errors after 0, 1 and 2 rounds, in rounds
    first_power, power = start.rms**2, view.rms**2
    curvature = doubled[1].rms ** 2 - 2.0 * power + first_power
    rounds = MAX_EXTRAPOLATION
    if curvature > 0.0:
        slope = power - first_power - 0.5 * curvature
        rounds = float(np.clip(-slope / curvature, 1.0, MAX_EXTRAPOLATION))
    candidates = ((refined, view), doubled, extrapolate(rounds - 1.0))
    return min(candidates, key=lambda result: result[1].rms)


def with_step(effect: SelectedEffect, name: str, step: float) -> SelectedEffect:
    """Return an effect with one parameter changed by a fraction of its width, within limits.

    A width above 1 is a factor, one below 1 a difference.
    """
    width, value = effect.free[name], effect.parameters[name]
    stepped = value * width**step if width > 1.0 else value + step * width
    parameters: Parameters = {**effect.parameters, name: _limited(effect, name, stepped)}
    return replace(effect, parameters=parameters)


def _limited(effect: SelectedEffect, name: str, value: float) -> float:
    low, high = effect.limits.get(name, (-float("inf"), float("inf")))
    return min(max(value, low), high)


def _settled_view(clean: View, effects: Sequence[SelectedEffect], start: View | None) -> View:
    """Return the view after further rounds from a start, so that steps can be compared with it.

    Without a start the rounds begin at the settled view of the same effects.
    """
    return with_effects(clean, effects, start or with_effects(clean, effects))


def _line_search(
    best: Refined, clean: View, selected: Sequence[SelectedEffect], name: str, fraction: float
) -> Refined:
    """Step in the direction that reduces the error, else to the vertex of a parabola."""

    def trial(origin: Refined, step: float) -> Refined:
        effect = with_step(origin[0], name, step)
        return effect, with_effects(clean, [*selected, effect], origin[1])

    errors = []
    for step in (fraction, -fraction):
        result = trial(best, step)
        errors.append(result[1].rms)
        if not _is_better(result, best):
            continue
        for _ in range(MAX_STEPS):
            next_result = trial(result, step)
            if not _is_better(next_result, result):
                break
            result = next_result
        return result
    curvature = errors[0] + errors[1] - 2.0 * best[1].rms
    vertex = 0.5 * fraction * (errors[1] - errors[0]) / curvature if curvature > 0.0 else 0.0
    vertex = min(max(vertex, -fraction), fraction)  # far away if the errors are nearly equal
    if abs(vertex) <= MIN_VERTEX * fraction:
        return best
    return min(best, trial(best, vertex), key=lambda result: result[1].rms)


def _is_better(result: Refined, reference: Refined) -> bool:
    return result[1].rms < reference[1].rms * (1.0 - MIN_GAIN)
