"""Extended: tracks with the effects that were selected, refitted with all of them in place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.effect import Effect, Parameters
from piezoid.diagnosis.residual_view import View, with_let_through
from piezoid.numerics.arrays import Array

CURVE = 3  # degree
CALM = 0.03  # of the power of the recording that rings most
FEWEST = 2  # rows for a column
ROUNDS = 6  # of static response and what effects make of it
SETTLED = 2e-3  # of the rms
EDGE = 0.03  # of a limit: so near it is at it


def without_memory(view: View) -> View:
    """Return the view with curves of the drive for static responses, where none were given."""
    if view.guess is not None:
        return view
    drive, static = view.of(lambda _, t: t.drive), view.rows(view.static)
    curve = np.polyfit(drive, static, CURVE)
    return replace(view, guess=tuple(np.asarray(np.polyval(curve, t.drive)) for t in view.tracks))


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectedEffect:
    """An effect with its nonlinear parameters.

    free    which of them are worth refining: by which factor (above 1) or step (below) to try
    limits  ranges of these
    from_jumps  whether it was seen behind jumps of the drive, where it is judged then
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
            low * (1.0 + EDGE) < self.parameters[name] < high * (1.0 - EDGE)
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


def extended(clean: View, selected: Sequence[SelectedEffect], near: View | None = None) -> View:
    """Return the view in which these effects are at work.

    What acts on the drive changes the drive, for good. Filters and columns are made of a static
    response that itself is fitted beside them, round after round until the error settles.

    near  a view with nearly the same at work: its static response is where the rounds begin
    """
    view = driven(clean, selected)
    behind = [one for one in selected if one.effect.drive_filter is None]
    if not behind:
        return view
    calm = undisturbed_for(view, behind)
    here, last = view, view.rms
    if near is not None:
        here, last = replace(view, guess=near.static), near.rms
    for _ in range(ROUNDS):
        offset, columns = offset_of(here, behind), columns_of(here, behind, calm)
        here = view = replace(view, offset=offset, selected=columns)
        if abs(view.rms / last - 1.0) < SETTLED:
            break
        last = view.rms
    return view


def driven(clean: View, selected: Sequence[SelectedEffect]) -> View:
    """Return the view with the commands that these effects let through.

    The last one is kept: what is refined behind a limit asks for the same again and again.
    """
    limits = [one for one in selected if one.effect.drive_filter is not None]
    asked = tuple((one.effect.name, *sorted(one.parameters.items())) for one in limits)
    found = clean.driven.get(asked) if limits else clean
    if found is None:  # another thread may take the room at any time
        found = _behind_limits(clean, limits)
        clean.driven.clear()
        clean.driven[asked] = found
    return found


def _behind_limits(clean: View, limits: Sequence[SelectedEffect]) -> View:
    def let_through(command: Array, rate_Hz: float) -> Array:
        for one in limits:
            assert one.effect.drive_filter is not None
            command = one.effect.drive_filter(command, rate_Hz, one.parameters)
        return command

    return with_let_through(clean, let_through)


def offset_of(view: View, selected: Sequence[SelectedEffect]) -> Array:
    """Return what all filters together make of the static response, less that, at the rows."""
    parts = []
    for track, static in zip(view.tracks, view.static, strict=True):
        read = static
        for one in selected:
            if one.effect.response_filter is not None:
                read = one.effect.response_filter(read, track.rate_Hz, one.parameters)
        parts.append((read - static)[track.place])
    return np.concatenate(parts)


def undisturbed_for(view: View, selected: Sequence[SelectedEffect]) -> View:
    """Return the view of which the columns of those are made that ring; itself where none does.

    Its static responses know nothing of ringing, where none were given. A drive that repeats puts
    its harmonics on a mode, and plays follow ringing that repeats as if it were hysteresis. A mode
    as sharp as Q makes Q times as much of what they followed, so columns made of that fit lead
    away from the mode. Slow recordings know the hysteresis without it; where there are none, a
    curve of the drive, which cannot ring, is nearer to what drives it.
    """
    rings = [one for one in selected if one.effect.may_be_absorbed]
    if not rings or view.guess is not None:
        return view
    plain = without_memory(view)
    power = np.sum(columns_of(plain, rings, plain) ** 2, axis=1)
    edges = view.nuisance.edges
    mean = np.array([power[a:b].mean() for a, b in pairwise(edges)])
    calm = np.repeat(mean < CALM * mean.max(), np.diff(edges))
    columns = view.nuisance.columns
    if np.count_nonzero(calm) < FEWEST * columns.shape[1]:
        return plain
    null = Null(columns=columns[calm], response=view.response[calm], block=view.block[calm])
    weight = null.fit(null.response)[: view.nuisance.shared]
    static = [view.nuisance.static(k, weight) for k in range(len(view.tracks))]
    return replace(view, guess=tuple(static))


def columns_of(view: View, selected: Sequence[SelectedEffect], calm: View) -> Array:
    """Return the columns of all selected effects that act on the response.

    calm  the view of which the columns of those are made that ring
    """
    parts = [np.zeros((len(view.offset), 0))]
    for one in selected:
        if one.adds_columns and one.effect.columns is not None:
            parts.append(
                one.effect.columns(calm if one.effect.may_be_absorbed else view, one.parameters)
            )
        if one.effect.covariates is not None:
            parts.append(one.effect.covariates(view))
    return np.hstack(parts)
