"""Refinement: the nonlinear parameters of an effect, with the whole model refitted at every try.

A tangent tells where to look; what decides is the error with the real thing in place. The search
walks along one parameter after another by ever smaller steps.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.refitted_view import SelectedEffect, extended
from piezoid.diagnosis.residual_view import View

PARTS = (1.0, 0.3, 0.1, 0.03)  # of a parameter's width
STEPS = 6
LEAST_STEP = 0.05
FARTHEST = 5.0  # times the way of one round
BETTER = 5e-4  # of the error: what a step must gain


Refined = tuple[SelectedEffect, View]


def initial_guess(effect: Effect, trial: Trial, coefficient: float) -> SelectedEffect:
    """Return an effect as its best tangent has it.

    Of a filter that all passes, a tangent with a share of 1.7 means a time 1.7 times as long.
    """
    parameters = dict(trial.parameters)
    if effect.response_filter is not None:
        stretch = float(np.clip(coefficient, 0.2, 5.0))
        parameters |= {name: parameters[name] * stretch for name in trial.free}
    return SelectedEffect(
        effect=effect, parameters=parameters, free=trial.free, limits=trial.limits
    )


def refined(
    one: SelectedEffect,
    clean: View,
    others: Sequence[SelectedEffect],
    *,
    finer: int = 0,
    near: View | None = None,
) -> tuple[SelectedEffect, View]:
    """Return an effect with better parameters beside others, and the view with all at work.

    finer  how many of the coarse steps to leave out, for parameters that are nearly right
    near   a view with nearly the same at work
    """
    best = (one, _settled(clean, [*others, one], near))
    for part in PARTS[finer:]:
        for name in one.free:
            best = _walked(best, clean, others, name, part)
    return best


def _settled(clean: View, selected: Sequence[SelectedEffect], near: View | None) -> View:
    """Return the view a round beyond where rounds from afar end: steps begin from here."""
    return extended(clean, selected, near or extended(clean, selected))


def refined_together(
    several: Sequence[SelectedEffect], clean: View, others: Sequence[SelectedEffect]
) -> tuple[list[SelectedEffect], View]:
    """Return effects with parameters that are better together, and the view with all at work.

    One after the other creeps along a valley: a limit found without the lag behind it follows a
    part of the lag. So the way they went in one round is gone on, as far as a parabola says.

    Source: Hooke & Jeeves, J. ACM 8 (1961), the pattern move.
    """
    there, start = list(several), _settled(clean, [*others, *several], None)
    view = start
    for k, one in enumerate(several):
        rest = [*others, *there[:k], *there[k + 1 :]]
        there[k], view = refined(one, clean, rest, finer=1, near=view)

    def onward(length: float) -> tuple[list[SelectedEffect], View]:
        state = [_beyond(a, b, length) for a, b in zip(several, there, strict=True)]
        return state, extended(clean, [*others, *state], view)

    twice = onward(1.0)
    length = _lowest(start.rms**2, view.rms**2, twice[1].rms ** 2) - 1.0
    return min((there, view), twice, onward(length), key=lambda found: found[1].rms)


def _lowest(none: float, once: float, twice: float) -> float:
    """Return how many steps lead to the lowest place of a parabola through three errors."""
    bend = twice - 2.0 * once + none
    slope = once - none - 0.5 * bend
    return float(np.clip(-slope / bend, 1.0, FARTHEST)) if bend > 0.0 else FARTHEST


def _beyond(before: SelectedEffect, now: SelectedEffect, length: float) -> SelectedEffect:
    """Return an effect as many times as far on as it came."""
    parameters = dict(now.parameters)
    for name, width in now.free.items():
        a, b = before.parameters[name], now.parameters[name]
        state = b * (b / a) ** length if width > 1.0 else b + length * (b - a)
        low, high = now.limits.get(name, (-float("inf"), float("inf")))
        parameters[name] = min(max(state, low), high)
    return replace(now, parameters=parameters)


def _walked(
    best: Refined, clean: View, others: Sequence[SelectedEffect], name: str, part: float
) -> Refined:
    """Step on to the side that gets better, or to where a parabola through three errors ends."""

    def tried(step: float) -> Refined:
        there = stepped(best[0], name, step)
        return there, extended(clean, [*others, there], best[1])

    sides = []
    for sign in (1.0, -1.0):
        there = tried(sign * part)
        if there[1].rms < best[1].rms * (1.0 - BETTER):
            return _onward(there, clean, others, name, sign * part)
        sides.append(there[1].rms)
    bend = sides[0] + sides[1] - 2.0 * best[1].rms
    vertex = 0.5 * part * (sides[1] - sides[0]) / bend if bend > 0.0 else 0.0
    vertex = min(max(vertex, -part), part)  # of sides that are as good as equal it is anywhere
    there = tried(vertex) if abs(vertex) > LEAST_STEP * part else best
    return min(best, there, key=lambda one: one[1].rms)


def _onward(
    best: Refined, clean: View, others: Sequence[SelectedEffect], name: str, step: float
) -> Refined:
    for _ in range(STEPS):
        there = stepped(best[0], name, step)
        view = extended(clean, [*others, there], best[1])
        if not view.rms < best[1].rms * (1.0 - BETTER):
            break
        best = there, view
    return best


def stepped(one: SelectedEffect, name: str, part: float) -> SelectedEffect:
    """Return an effect with one parameter a part of its width farther on."""
    parameters: Parameters = {**one.parameters, name: moved(one, name, part)}
    return replace(one, parameters=parameters)


def moved(one: SelectedEffect, name: str, part: float) -> float:
    """Return a parameter a part of its width farther on: by a factor, or by a step below 1."""
    width, value = one.free[name], one.parameters[name]
    there = value * width**part if width > 1.0 else value + part * width
    low, high = one.limits.get(name, (-float("inf"), float("inf")))
    return min(max(there, low), high)
