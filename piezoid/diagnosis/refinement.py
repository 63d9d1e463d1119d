"""Selected effects: the nuisance class refitted beside them, and their parameters refined.

Tangents only give start values; the error with the effect in the model decides. The nonlinear
parameters of all effects are refined together, with the whole model refitted at every step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.residual_view import (
    LinearFilter,
    LinearPath,
    View,
    with_filtered_commands,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import Rows, Rule, minimise

POLYNOMIAL_DEGREE = 3
MAX_RINGING = 0.03  # power of ringing over that in the recording that rings most: none below it
ROWS_PER_COLUMN = 2  # of recordings without ringing
MAX_ROUNDS = 6  # of fitting the static response and applying effects to it
SETTLED = 2e-3  # change of the rms below which the rounds end
SHARE_LIMITS = (-1.0, 3.0)  # of a mode, during the rounds
AT_LIMIT = 0.03  # relative distance from a limit below which a parameter counts as at the limit
NUDGE = 0.1  # of a parameter's width, for derivatives
LONGEST_STEP = 2.0  # widths
RULE = Rule(tolerance=3e-3, iterations=8, tries=4, damping=1e-2)


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

    Filters of the drive change the drive. The columns of the nuisance class are fitted behind the
    filters of the response and behind the modes. Columns of effects are computed from the static
    response, which is fitted beside them: in rounds, until the error settles. In each round the
    column of a mode corrects its share.

    start  a view with similar effects; its static response and shares are the start of the rounds
    """
    view = with_filtered_drive(clean, effects)
    on_response = [effect for effect in effects if effect.effect.drive_filter is None]
    if not on_response:
        return view
    is_fitted = view.static_override is None
    modes = [effect for effect in on_response if is_fitted and _is_path(effect)]
    on_stage = [e for e in on_response if not (e in modes or e.effect.is_sensor_error)]
    on_sensor = [effect for effect in on_response if effect.effect.is_sensor_error]
    path = LinearPath(
        filters={e.effect.name: linear_filter(e) for e in on_response if e.effect.response_filter},
        modes={effect.effect.name: linear_filter(effect) for effect in modes},
        shares={effect.effect.name: 0.0 for effect in modes},
    )
    if path.filters or path.modes:
        view = replace(view, path=path)
    source = ringing_source = without_ringing(view, on_response)
    if start is not None and start.static_override is None and is_fitted:
        static = tuple(view.nuisance.static(k, start.weight) for k in range(len(view.tracks)))
        source = replace(view, static_override=static)
        if start.path is not None:
            path = replace(path, shares={**path.shares, **start.path.shares})
    last_rms = np.inf
    for _ in range(MAX_ROUNDS):
        parts = [
            (effect, effect_columns(ringing_source if effect.from_jumps else source, [effect]))
            for effect in (*modes, *on_stage, *on_sensor)
        ]
        edges = np.cumsum([0, *(columns.shape[1] for _, columns in parts)]).tolist()
        fitted = replace(
            view,
            path=path if view.path is not None else None,
            selected=np.hstack([columns for _, columns in parts]),
            coefficients_of={
                effect.effect.name: slice(*span)
                for (effect, _), span in zip(parts, pairwise(edges), strict=True)
            },
            sensor_columns=edges[-1] - edges[len(modes) + len(on_stage)],
        )
        is_exact = not edges[-1] or not is_fitted
        if is_exact or abs(fitted.rms / last_rms - 1.0) < SETTLED:
            break
        last_rms = fitted.rms
        count = fitted.nuisance.columns.shape[1]
        corrections = fitted.null.coefficients[count : count + len(modes)]
        shares = {
            name: float(np.clip(path.shares[name] + correction, *SHARE_LIMITS))
            for name, correction in zip(path.modes, corrections, strict=True)
        }
        path = replace(path, shares=shares)
        source = fitted
    return fitted


def _is_path(effect: SelectedEffect) -> bool:
    """Tell whether an effect is a mode through which a fitted static response moves.

    A mode after steps of the drive has columns only: the phase of each step is free.
    """
    return effect.effect.mode_filter is not None and not effect.from_jumps


def linear_filter(selected: SelectedEffect) -> LinearFilter:
    """Return the filter of an effect of the response, or of a mode."""
    filter_ = selected.effect.response_filter or selected.effect.mode_filter
    assert filter_ is not None
    return lambda signal, rate_Hz: filter_(signal, rate_Hz, selected.parameters)


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


def effect_columns(view: View, effects: Sequence[SelectedEffect]) -> Array:
    """Return the columns of all effects that act on the response."""
    columns = [np.zeros((len(view.response), 0))]
    for effect in effects:
        if effect.adds_columns and effect.effect.columns is not None:
            columns.append(effect.effect.columns(view, effect.parameters))
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
    power = np.sum(effect_columns(polynomial, modes) ** 2, axis=1)
    mean = np.add.reduceat(power, view.nuisance.edges[:-1]) / np.diff(view.nuisance.edges)
    sources = (_fitted_to_tracks(view, mean < MAX_RINGING * mean.max()), polynomial)

    def error(source: View) -> float:
        return replace(view, selected=effect_columns(source, modes)).rms

    return min((source for source in sources if source is not None), key=error)


def _fitted_to_tracks(view: View, is_fitted: NDArray[np.bool_]) -> View | None:
    """Return the view with the static response fitted to some tracks; None if they are too short.

    It is cached, because the tracks without ringing hardly depend on the mode.
    """
    key = tuple(is_fitted.tolist())
    source = view.cache.get(key)
    if source is None:
        rows, columns = np.repeat(is_fitted, np.diff(view.nuisance.edges)), view.nuisance.columns
        if np.count_nonzero(rows) < ROWS_PER_COLUMN * columns.shape[1]:
            return None
        null = Null(columns=columns[rows], response=view.response[rows], block=view.block[rows])
        weight = null.fit(null.response)[: view.nuisance.shared]
        static = tuple(view.nuisance.static(k, weight) for k in range(len(view.tracks)))
        source = view.cache[key] = replace(view, static_override=static)
    return source


def with_polynomial_response(view: View) -> View:
    """Return the view with polynomials of the drive as static responses.

    A view with other static responses than the fitted ones stays as it is.
    """
    if view.static_override is not None:
        return view
    drive, response = view.column(lambda _, track: track.drive), view.rows(view.unfiltered)
    polynomial = np.polyfit(drive, response, POLYNOMIAL_DEGREE)
    static = tuple(np.asarray(np.polyval(polynomial, track.drive)) for track in view.tracks)
    return replace(view, static_override=static)


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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """A view with effects at some values of their free parameters, for the search.

    effects  all effects of the view; the last ``count`` of them are refined
    """

    clean: View
    effects: tuple[SelectedEffect, ...]
    count: int
    view: View

    @property
    def cost(self) -> float:
        """Return the mean square of the residual."""
        return self.view.rms**2

    def linearised(self) -> Rows:
        """Return the residual and its derivatives by the free parameters, per step width."""
        fixed = len(self.effects) - self.count
        tangents = parameter_tangents(self.view, self.clean, self.effects, fixed=fixed)
        scale = 1.0 / np.sqrt(len(self.view.response))
        return Rows(factor=-scale * tangents, residual=scale * self.view.null.residual)


def refine(
    effects: Sequence[SelectedEffect],
    clean: View,
    others: Sequence[SelectedEffect] = (),
    *,
    start: View | None = None,
) -> tuple[tuple[SelectedEffect, ...], View]:
    """Refine the free parameters of effects together, beside other effects that stay.

    The coefficients of all columns are eliminated (variable projection), and the parameters are
    searched in units of their step widths, of their logarithm if the width is a factor.

    start  a view with similar effects, to start the rounds of ``with_effects``

    Returns the refined effects, and the view with them and the others.
    """
    names = [(k, name) for k, effect in enumerate(effects) for name in effect.free]
    # further rounds from the start, so that steps can be compared with this view
    latest = with_effects(clean, [*others, *effects], start)
    latest = with_effects(clean, [*others, *effects], latest)
    if not names:
        return tuple(effects), latest

    def at(steps: Array) -> _Trial:
        stepped = _stepped(effects, names, steps)
        view = with_effects(clean, [*others, *stepped], latest) if np.any(steps) else latest
        return _Trial(clean=clean, effects=(*others, *stepped), count=len(effects), view=view)

    limits = [_steps_to_limits(effects[k], name) for k, name in names]
    lower, upper = np.array(limits).T
    minimum = minimise(at, np.zeros(len(names)), (lower, upper), rule=RULE, longest=LONGEST_STEP)
    return minimum.point.effects[len(others) :], minimum.point.view


def parameter_tangents(
    view: View, clean: View, effects: Sequence[SelectedEffect], *, fixed: int = 0
) -> Array:
    """Return the derivatives of the model by the free parameters, (rows, parameters).

    Per step width, and orthogonal to the columns of the view, whose coefficients are refitted.

    view   of the clean view with the effects
    fixed  number of the first effects whose parameters are not free
    """
    tangents = []
    for k, effect in enumerate(effects):
        if k < fixed:
            continue
        others = with_filtered_drive(clean, [*effects[:k], *effects[k + 1 :]])
        tangents += [parameter_tangent(view, others, effect, name) for name in effect.free]
    if not tangents:
        return np.zeros((len(view.response), 0))
    return view.null.project_out(np.column_stack(tangents))


def parameter_tangent(view: View, others: View, effect: SelectedEffect, name: str) -> Array:
    """Return the derivative of the model by a parameter at fixed coefficients, (rows,).

    Per step width.

    view    with the effect and others
    others  the view with the drive filters of the others
    """
    nudge = NUDGE if _steps_to_limits(effect, name)[1] > NUDGE else -NUDGE
    nudged, definition, path = with_step(effect, name, nudge), effect.effect, view.path
    if definition.drive_filter is not None:
        tracks = with_filtered_drive(others, [nudged]).tracks
        change = np.concatenate(
            [
                view.nuisance.static_rows(k, view.weight, track.drive) - static[track.rows]
                for k, (track, static) in enumerate(zip(tracks, view.unfiltered, strict=True))
            ]
        )
    elif path is not None and definition.name in {**path.filters, **path.modes}:
        replaced = {definition.name: linear_filter(nudged)}
        nudged_path = (
            replace(path, filters={**path.filters, **replaced})
            if definition.name in path.filters
            else replace(path, modes={**path.modes, **replaced})
        )
        change = np.concatenate(
            [
                (nudged_path.moved(static, track.rate_Hz) - path.moved(static, track.rate_Hz))[
                    track.rows
                ]
                for static, track in zip(view.unfiltered, view.tracks, strict=True)
            ]
        )
    else:
        assert definition.columns is not None
        place = view.coefficients_of[definition.name]
        first = view.nuisance.columns.shape[1] + place.start
        coefficient = view.null.coefficients[first : first + place.stop - place.start]
        own = slice(0, definition.columns(view, effect.parameters).shape[1])
        difference = definition.columns(view, nudged.parameters) - definition.columns(
            view, effect.parameters
        )
        change = difference @ coefficient[own]
    return np.asarray(change / nudge)


def with_parameter_tangents(
    view: View, clean: View, effects: Sequence[SelectedEffect], *, fixed: int = 0
) -> View:
    """Return the view in which the free parameters of its effects may change a little.

    Tested on it, another effect gains only what no change of these parameters explains, and its
    coefficient is that with all of them refitted.
    """
    tangents = parameter_tangents(view, clean, effects, fixed=fixed)
    count = tangents.shape[1]
    return replace(
        view,
        selected=np.hstack([tangents, view.selected]),
        coefficients_of={
            name: slice(place.start + count, place.stop + count)
            for name, place in view.coefficients_of.items()
        },
    )


def _stepped(
    effects: Sequence[SelectedEffect], names: Sequence[tuple[int, str]], steps: Array
) -> tuple[SelectedEffect, ...]:
    stepped = list(effects)
    for (k, name), step in zip(names, steps.tolist(), strict=True):
        stepped[k] = with_step(stepped[k], name, step)
    return tuple(stepped)


def _steps_to_limits(effect: SelectedEffect, name: str) -> tuple[float, float]:
    """Return the limits of a parameter in steps from its value, <= 0 and >= 0."""
    width, value = effect.free[name], effect.parameters[name]
    low, high = effect.limits.get(name, (-np.inf, np.inf))
    if width > 1.0:
        low, high = np.log(np.maximum((low, high), 1e-300) / value) / np.log(width)
    else:
        low, high = ((limit - value) / width for limit in (low, high))
    return min(low, 0.0), max(high, 0.0)


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
