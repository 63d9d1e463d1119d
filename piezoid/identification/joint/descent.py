"""Bounded Gauss-Newton over everything at once, and the same on the rows kept of each fold.

A step solves the damped normal equations within the bounds. Forming them squares the condition of
the columns; the damping, relative to each column, is what keeps that harmless, and every step is
judged by the true error. On a fold the columns of the whole search serve again: only the error
is new (a chord step), and what is left out has no say.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.joint.chain import follow, residual
from piezoid.identification.joint.parts import FOLDS, Part
from piezoid.identification.joint.tangents import tangents_of
from piezoid.identification.joint.vector import State
from piezoid.numerics.arrays import Array
from piezoid.numerics.bounded import bounded_minimum

CONVERGED = 1e-4
TRIES = 8
CHORDS = 3  # steps on the rows kept
FIRM = (1e-6, 1e-4, 1e-2, 1.0)  # damping on a fold, tried in turn


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """Where a search ended.

    state  there
    rms    of the residual at all rows, scaled
    held   (rows,)  residual at the rows left out, fold after fold
    rows   rows of all parts
    folds  (folds, numbers)  the vectors of the folds
    converged  whether the last step hardly changed the error
    """

    state: State
    rms: float
    held: Array
    rows: int
    folds: Array
    converged: bool

    @property
    def held_out_rms(self) -> float:
        """Return the rms on rows left out."""
        return float(np.sqrt(np.mean(self.held**2)))


def search(state: State, parts: Sequence[Part], *, longest_lag_s: float, steps: int) -> Reached:
    """Search from a point for the least error, then repeat it on the rows kept of each fold."""
    state = state.at(np.clip(state.vector, *state.bounds(longest_lag_s)))
    errors = [residual(state, k, part) for k, part in enumerate(parts)]
    damping, converged = 1e-4, False
    rows = _tangents(state, parts)
    for _ in range(steps):
        before = _cost(errors)
        state, errors, damping = _stepped(state, parts, rows, errors, longest_lag_s, damping)
        rows = _tangents(state, parts)
        if 1.0 - _cost(errors) / before < CONVERGED:
            converged = True
            break
    held, folds = _folded(state, parts, rows, errors, longest_lag_s)
    count = sum(len(error) for error in errors)
    return Reached(
        state=state,
        rms=float(np.sqrt(_cost(errors) / count)),
        held=held,
        rows=count,
        folds=folds,
        converged=converged,
    )


def _cost(errors: Sequence[Array]) -> float:
    return sum(float(error @ error) for error in errors)


def _tangents(state: State, parts: Sequence[Part]) -> list[Array]:
    return [tangents_of(state, k, p, follow(state, k, p)) for k, p in enumerate(parts)]


def _stepped(
    state: State,
    parts: Sequence[Part],
    rows: Sequence[Array],
    errors: list[Array],
    longest_lag_s: float,
    damping: float,
) -> tuple[State, list[Array], float]:
    """Return the next point, or this one where no step is better."""
    gram = sum((part.T @ part for part in rows), np.zeros((1, 1)))
    slope = sum((part.T @ error for part, error in zip(rows, errors, strict=True)), np.zeros(1))
    gram, slope = _with_prior(state, gram, slope)
    cost, bounds = _cost(errors) + _prior_cost(state), state.bounds(longest_lag_s)
    for _ in range(TRIES):
        trial = state.at(_next(state.vector, gram, slope, bounds, damping))
        found = [residual(trial, k, part) for k, part in enumerate(parts)]
        if _cost(found) + _prior_cost(trial) < cost:
            return trial, found, max(damping / 10.0, 1e-9)
        damping *= 10.0
    return state, errors, damping


def _with_prior(state: State, gram: Array, slope: Array) -> tuple[Array, Array]:
    """Add what is known beforehand, with the weight of one row each."""
    gram, slope = gram.copy(), slope.copy()
    for rows, value, place in _priors(state):
        gram[place, place] += rows.T @ rows
        slope[place] += rows.T @ (rows @ value)
    return gram, slope


def _priors(state: State) -> list[tuple[Array, Array, slice]]:
    found = []
    for extension, place in zip(state.extensions, state.slices, strict=True):
        scale = abs(state.scales.displacement_m) if extension.in_metres else 1.0
        found.append((extension.prior() / scale, extension.free().value, place))
    return found


def _prior_cost(state: State) -> float:
    return sum(float(np.sum((rows @ value) ** 2)) for rows, value, _ in _priors(state))


def _next(
    vector: Array, gram: Array, slope: Array, bounds: tuple[Array, Array], damping: float
) -> Array:
    """Return the end of the damped step, within the bounds."""
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    scaled = gram / np.outer(scale, scale) + damping * np.eye(len(scale))
    lower, upper = (bounds[0] - vector) * scale, (bounds[1] - vector) * scale
    step = bounded_minimum(scaled, -slope / scale, lower, upper)
    return np.clip(vector + step / scale, *bounds)


def _folded(
    state: State,
    parts: Sequence[Part],
    rows: Sequence[Array],
    errors: Sequence[Array],
    longest_lag_s: float,
) -> tuple[Array, Array]:
    """Return the residual at the rows left out, and the vectors of the folds."""
    held, vectors = [], []
    for fold in range(FOLDS):
        kept = [part.fold != fold for part in parts]
        own = [r[k] for r, k in zip(rows, kept, strict=True)]  # megabytes: not for every step
        # An array times itself is rounded otherwise: enough to move a controller's free poles.
        gram = sum((r[k].T @ o for r, k, o in zip(rows, kept, own, strict=True)), np.zeros((1, 1)))
        here, now = state, list(errors)
        for _ in range(CHORDS):
            there, found = _chord(here, parts, own, now, kept, gram, longest_lag_s)
            if there is here:
                break
            here, now = there, found
        held += [error[~k] for error, k in zip(now, kept, strict=True)]
        vectors.append(here.vector)
    return np.concatenate(held), np.array(vectors)


def _chord(
    state: State,
    parts: Sequence[Part],
    rows: Sequence[Array],
    errors: list[Array],
    kept: Sequence[Array],
    gram: Array,
    longest_lag_s: float,
) -> tuple[State, list[Array]]:
    """Return the next point on the rows kept; firmer where the first step fails."""
    across = zip(rows, errors, kept, strict=True)
    slope = sum((r.T @ e[k] for r, e, k in across), np.zeros(1))
    whole = _with_prior(state, gram, slope)
    before, bounds = _kept_cost(errors, kept) + _prior_cost(state), state.bounds(longest_lag_s)
    for damping in FIRM:
        trial = state.at(_next(state.vector, *whole, bounds, damping))
        found = [residual(trial, k, part) for k, part in enumerate(parts)]
        if _kept_cost(found, kept) + _prior_cost(trial) < before:
            return trial, found
    return state, errors


def _kept_cost(errors: Sequence[Array], kept: Sequence[Array]) -> float:
    return sum(float(np.sum(error[k] ** 2)) for error, k in zip(errors, kept, strict=True))
