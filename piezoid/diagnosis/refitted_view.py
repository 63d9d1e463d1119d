"""Views with selected effects: the nuisance class refitted with all of them in the model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Effect, Parameters
from piezoid.diagnosis.residual_view import View, with_filtered_commands
from piezoid.numerics.arrays import Array

POLYNOMIAL_DEGREE = 3
QUIET = 0.03  # of the power of ringing in the recording that rings most
ROWS_PER_COLUMN = 2  # of quiet recordings
MAX_ROUNDS = 6  # of fitting the static response and applying effects to it
SETTLED = 2e-3  # change of the rms below which the rounds end
AT_LIMIT = 0.03  # of a limit: a parameter as near counts as at it


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectedEffect:
    """An effect with its nonlinear parameters.

    free        parameters to refine: by which factor (above 1) or step (below) to try
    limits      ranges of these
    from_jumps  whether it was detected in step responses, on which it is then evaluated
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
        """Whether it adds columns with free coefficients."""
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

    Effects on the drive change the drive. Filters of the response and columns are made from a
    static response that is itself fitted beside them, round after round until the error settles.

    start  a view with similar effects, at whose static response the rounds begin
    """
    view = with_filtered_drive(clean, effects)
    on_response = [effect for effect in effects if effect.effect.drive_filter is None]
    if not on_response:
        return view
    ringing_source = without_ringing(view, on_response)
    source, last_rms = view, view.rms
    if start is not None:
        source, last_rms = replace(view, guess=start.static), start.rms
    for _ in range(MAX_ROUNDS):
        offset = filter_offset(source, on_response)
        columns = effect_columns(source, on_response, ringing_source)
        source = view = replace(view, offset=offset, selected=columns)
        if abs(view.rms / last_rms - 1.0) < SETTLED:
            break
        last_rms = view.rms
    return view


def with_filtered_drive(clean: View, effects: Sequence[SelectedEffect]) -> View:
    """Return the view with effects applied that filter the drive.

    The last such view is cached: refining effects of the response asks for it again and again.
    """
    filters = [effect for effect in effects if effect.effect.drive_filter is not None]
    if not filters:
        return clean
    key = tuple((effect.effect.name, *sorted(effect.parameters.items())) for effect in filters)
    view = clean.cache.get(key)
    if view is None:
        view = with_filtered_commands(clean, partial(_filter_drive, filters))
        clean.cache.clear()  # another thread may do the same at any time
        clean.cache[key] = view
    return view


def _filter_drive(filters: Sequence[SelectedEffect], command: Array, rate_Hz: float) -> Array:
    for limit in filters:
        assert limit.effect.drive_filter is not None
        command = limit.effect.drive_filter(command, rate_Hz, limit.parameters)
    return command


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
    """Return a view whose static response contains no ringing; the same if no effect is a mode.

    A periodic drive puts its harmonics on a mode, and plays follow periodic ringing as if it were
    hysteresis. A mode of quality factor Q amplifies the ringing in that static response Q times,
    so that columns made from it lead away from the mode. The hysteresis is therefore taken from
    slow recordings, or from a polynomial of the drive, which cannot ring, if there are none or if
    its modes explain more: what follows a few loops may be far off along other drives.
    """
    modes = [effect for effect in effects if effect.effect.may_be_absorbed]
    if not modes or view.guess is not None:
        return view
    polynomial = with_polynomial_response(view)
    power = np.sum(effect_columns(polynomial, modes, polynomial) ** 2, axis=1)
    edges = view.nuisance.edges
    mean = np.array([power[a:b].mean() for a, b in pairwise(edges)])
    is_quiet = np.repeat(mean < QUIET * mean.max(), np.diff(edges))
    columns = view.nuisance.columns
    if np.count_nonzero(is_quiet) < ROWS_PER_COLUMN * columns.shape[1]:
        return polynomial
    null = Null(
        columns=columns[is_quiet], response=view.response[is_quiet], block=view.block[is_quiet]
    )
    weight = null.fit(null.response)[: view.nuisance.shared]
    static = tuple(view.nuisance.static(k, weight) for k in range(len(view.tracks)))

    def error(source: View) -> float:
        return replace(view, selected=effect_columns(source, modes, source)).rms

    return min(replace(view, guess=static), polynomial, key=error)


def with_polynomial_response(view: View) -> View:
    """Return the view with polynomials of the drive as static responses, unless given."""
    if view.guess is not None:
        return view
    drive, static = view.of(lambda _, track: track.drive), view.rows(view.static)
    polynomial = np.polyfit(drive, static, POLYNOMIAL_DEGREE)
    guess = tuple(np.asarray(np.polyval(polynomial, track.drive)) for track in view.tracks)
    return replace(view, guess=guess)
