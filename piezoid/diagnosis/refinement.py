"""Selected effects: the nuisance class refitted beside them, and their parameters refined.

Tangents only give start values; the error with the effect in the model decides. The nonlinear
parameters are searched one after the other with decreasing steps, with the whole model refitted at
every step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.residual_view import View, with_filtered_commands
from piezoid.numerics.arrays import Array

POLYNOMIAL_DEGREE = 3
MAX_RINGING = 0.03  # power of ringing over that in the recording that rings most: none below it
ROWS_PER_COLUMN = 2  # of recordings without ringing
MAX_ROUNDS = 6  # of fitting the static response and applying effects to it
SETTLED = 2e-3  # change of the rms below which the rounds end
AT_LIMIT = 0.03  # relative distance from a limit below which a parameter counts as at the limit
STEP_FRACTIONS = (1.0, 0.3, 0.1, 0.03)  # of a parameter's width
MAX_STEPS = 6
MIN_VERTEX = 0.05  # of a step: a vertex nearer to its centre is not tried
MAX_EXTRAPOLATION = 5.0  # of the change in one round
MIN_GAIN = 5e-4  # of the error, by one step


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectedEffect:
    """An effect with its nonlinear parameters.

    free        parameters to refine, with the factor (above 1) or step (below 1) of a trial
    limits      ranges of these parameters
    from_jumps  whether the effect was detected in step responses, and is evaluated on these
    """

    effect: Effect
    parameters: Parameters
    free: Parameters = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    from_jumps: bool = False

    @property
    def within_limits(self) -> bool:
        """Whether no parameter lies at its limit."""
        return all(
            low * (1.0 + AT_LIMIT) < self.parameters[name] < high * (1.0 - AT_LIMIT)
            for name, (low, high) in self.limits.items()
        )

    @property
    def adds_columns(self) -> bool:
        """Whether the effect adds columns with free coefficients."""
        effect = self.effect
        return (
            effect.columns is not None
            and effect.response_filter is None
            and effect.drive_filter is None
        )


def with_effects(
    clean: View, effects: Sequence[SelectedEffect], start: View | None = None
) -> View:
    """Return the view with these effects in the model.

    Filters of the drive change the drive. Filters of the response and columns are computed from
    the static response, which is fitted beside them: in rounds, until the error settles.

    start  a view with similar effects; its static response is the start of the rounds
    """
    view = with_filtered_drive(clean, effects)
    on_response = [effect for effect in effects if effect.effect.drive_filter is None]
    if not on_response:
        return view
    on_sensor = [effect for effect in on_response if effect.effect.is_sensor_error]
    on_stage = [effect for effect in on_response if effect not in on_sensor]
    ringing_source = without_ringing(view, on_response)
    source, last_rms = view, view.rms
    if start is not None:
        source, last_rms = replace(view, static_override=start.static), start.rms
    for _ in range(MAX_ROUNDS):
        offset = filter_offset(source, on_response)
        columns = effect_columns(source, on_stage, ringing_source)
        sensor_columns = effect_columns(source, on_sensor, ringing_source)
        source = view = replace(
            view,
            offset=offset,
            selected=np.hstack([columns, sensor_columns]),
            sensor_columns=sensor_columns.shape[1],
        )
        if abs(view.rms / last_rms - 1.0) < SETTLED:
            break
        last_rms = view.rms
    return view


def with_filtered_drive(clean: View, effects: Sequence[SelectedEffect]) -> View:
    """Return the view with the filters of the drive applied.

    The last such view is cached, because each step of refining another effect needs it.
    """
    filters = [effect for effect in effects if effect.effect.drive_filter is not None]
    if not filters:
        return clean
    key = tuple((effect.effect.name, *sorted(effect.parameters.items())) for effect in filters)
    view = clean.cache.get(key)
    if view is None:

        def drive_filter(command: Array, rate_Hz: float) -> Array:
            for selected in filters:
                assert selected.effect.drive_filter is not None
                command = selected.effect.drive_filter(command, rate_Hz, selected.parameters)
            return command

        view = with_filtered_commands(clean, drive_filter)
        clean.cache.clear()  # another thread may do the same at any time
        clean.cache[key] = view
    return view


def filter_offset(view: View, effects: Sequence[SelectedEffect]) -> Array:
    """Return the change of the static response by all filters of the response, at the rows."""
    offsets = []
    for track, static in zip(view.tracks, view.static, strict=True):
        filtered = static
        for effect in effects:
            if effect.effect.response_filter is not None:
                filtered = effect.effect.response_filter(
                    filtered, track.rate_Hz, effect.parameters
                )
        offsets.append((filtered - static)[track.rows])
    return np.concatenate(offsets)


def effect_columns(view: View, effects: Sequence[SelectedEffect], ringing_source: View) -> Array:
    """Return the columns of all effects that act on the response.

    ringing_source  the view from which columns of modes are made
    """
    columns = [np.zeros((len(view.offset), 0))]
    for effect in effects:
        if effect.adds_columns and effect.effect.columns is not None:
            source = ringing_source if effect.effect.may_be_absorbed else view
            columns.append(effect.effect.columns(source, effect.parameters))
        if effect.effect.covariates is not None:
            columns.append(effect.effect.covariates(view))
    return np.hstack(columns)


def without_ringing(view: View, effects: Sequence[SelectedEffect]) -> View:
    """Return a view with a static response without ringing; the same view if no effect is a mode.

    Harmonics of a periodic drive excite a mode, and plays can follow periodic ringing as if it
    were hysteresis. A mode of quality factor Q amplifies the ringing in such a static response Q
    times, so that columns computed from it do not resemble the mode. The hysteresis is therefore
    fitted to recordings without ringing. If there are too few, or if the modes explain more with
    it, a polynomial of the drive replaces it: hysteresis fitted to a few loops may be wrong along
    other drives.
    """
    modes = [effect for effect in effects if effect.effect.may_be_absorbed]
    if not modes or view.static_override is not None:
        return view
    polynomial = with_polynomial_response(view)
    power = np.sum(effect_columns(polynomial, modes, polynomial) ** 2, axis=1)
    edges = view.nuisance.edges
    mean = np.array([power[first:stop].mean() for first, stop in pairwise(edges)])
    rows = np.repeat(mean < MAX_RINGING * mean.max(), np.diff(edges))
    columns = view.nuisance.columns
    if np.count_nonzero(rows) < ROWS_PER_COLUMN * columns.shape[1]:
        return polynomial
    null = Null(columns=columns[rows], response=view.response[rows], block=view.block[rows])
    weight = null.fit(null.response)[: view.nuisance.shared]
    static = tuple(view.nuisance.static(k, weight) for k in range(len(view.tracks)))

    def error(source: View) -> float:
        return replace(view, selected=effect_columns(source, modes, source)).rms

    return min(replace(view, static_override=static), polynomial, key=error)


def with_polynomial_response(view: View) -> View:
    """Return the view with polynomials of the drive as static responses.

    A view with other static responses than the fitted ones stays as it is.
    """
    if view.static_override is not None:
        return view
    drive, response = view.column(lambda _, track: track.drive), view.rows(view.static)
    polynomial = np.polyfit(drive, response, POLYNOMIAL_DEGREE)
    static = tuple(np.asarray(np.polyval(polynomial, track.drive)) for track in view.tracks)
    return replace(view, static_override=static)


Refined = tuple[SelectedEffect, View]  # an effect, and the view with it and all others


def initial_guess(effect: Effect, trial: Trial, coefficient: float) -> SelectedEffect:
    """Return an effect with the parameters of its best tangent.

    The tangent of a filter of the response is proportional to its free parameters: they are
    multiplied by the coefficient.
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
    # further rounds from the start, so that steps can be compared with this view
    effects = [*selected, effect]
    best = effect, with_effects(clean, effects, start or with_effects(clean, effects))
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
    refined, all_effects = list(effects), [*selected, *effects]
    view = start = with_effects(clean, all_effects, with_effects(clean, all_effects))
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
        if result[1].rms >= best[1].rms * (1.0 - MIN_GAIN):
            continue
        for _ in range(MAX_STEPS):
            next_result = trial(result, step)
            if next_result[1].rms >= result[1].rms * (1.0 - MIN_GAIN):
                break
            result = next_result
        return result
    curvature = errors[0] + errors[1] - 2.0 * best[1].rms
    vertex = 0.5 * fraction * (errors[1] - errors[0]) / curvature if curvature > 0.0 else 0.0
    vertex = min(max(vertex, -fraction), fraction)  # far away if the errors are nearly equal
    if abs(vertex) <= MIN_VERTEX * fraction:
        return best
    return min(best, trial(best, vertex), key=lambda result: result[1].rms)
