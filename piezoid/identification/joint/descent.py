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

CONVERGED = 1e-4
TRIES = 8
CHORDS = 3  # steps on the rows kept
FIRM = (1e-7, 1e-4, 1e-2)  # damping on a fold, tried in turn


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
    bounds = state.bounds(longest_lag_s)
    state = state.at(np.clip(state.vector, *bounds))
    errors = [residual(state, k, part) for k, part in enumerate(parts)]
    damping, converged = 1e-4, False
    rows = _tangents(state, parts)
    for _ in range(steps):
        before = _cost(errors)
        state, errors, damping = _stepped(state, parts, rows, errors, bounds, damping)
        rows = _tangents(state, parts)
        if 1.0 - _cost(errors) / before < CONVERGED:
            converged = True
            break
    held, folds = _folded(state, parts, rows, errors, bounds)
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
    bounds: tuple[Array, Array],
    damping: float,
) -> tuple[State, list[Array], float]:
    """Return the next point, or this one where no step is better."""
    gram = sum((part.T @ part for part in rows), np.zeros((1, 1)))
    slope = sum((part.T @ error for part, error in zip(rows, errors, strict=True)), np.zeros(1))
    gram, slope = _with_prior(state, gram, slope)
    cost = _cost(errors) + _prior_cost(state)
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


def bounded_minimum(gram: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Minimise x' G x / 2 - b' x with l <= x <= u, changing whole sets of bounds at once.

    G, b  (numbers, numbers), (numbers,)  G positive definite
    l, u  (numbers,)  l <= 0 <= u

    Ends after a fixed number of rounds: the step is then still inside the bounds, if not the best.
    """
    from scipy.linalg import cho_factor, cho_solve

    x = np.zeros(len(right))
    free = upper > lower
    for _ in range(20):
        inner = np.ix_(free, free)
        against = right[free] - gram[np.ix_(free, ~free)] @ x[~free]
        found = cho_solve(cho_factor(gram[inner]), against)
        x[free] = np.clip(found, lower[free], upper[free])
        outside = np.zeros_like(free)
        outside[free] = (found < lower[free]) | (found > upper[free])
        if outside.any():
            free = free & ~outside
            continue
        slope = gram @ x - right
        inwards = ((x <= lower) & (slope < 0.0)) | ((x >= upper) & (slope > 0.0))
        inwards &= ~free & (upper > lower) & (np.abs(slope) > 1e-12)
        if not inwards.any():
            break
        free = free | inwards
    return x


def _folded(
    state: State,
    parts: Sequence[Part],
    rows: Sequence[Array],
    errors: Sequence[Array],
    bounds: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Return the residual at the rows left out, and the vectors of the folds."""
    held, vectors = [], []
    for fold in range(FOLDS):
        kept = [part.fold != fold for part in parts]
        gram = sum((r[k].T @ r[k] for r, k in zip(rows, kept, strict=True)), np.zeros((1, 1)))
        here, now = state, list(errors)
        for _ in range(CHORDS):
            there, found = _chord(here, parts, rows, now, kept, gram, bounds)
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
    bounds: tuple[Array, Array],
) -> tuple[State, list[Array]]:
    """Return the next point on the rows kept; firmer where the first step fails."""
    across = zip(rows, errors, kept, strict=True)
    slope = sum((r[k].T @ e[k] for r, e, k in across), np.zeros(1))
    whole = _with_prior(state, gram, slope)
    before = _kept_cost(errors, kept) + _prior_cost(state)
    for damping in FIRM:
        trial = state.at(_next(state.vector, *whole, bounds, damping))
        found = [residual(trial, k, part) for k, part in enumerate(parts)]
        if _kept_cost(found, kept) + _prior_cost(trial) < before:
            return trial, found
    return state, errors


def _kept_cost(errors: Sequence[Array], kept: Sequence[Array]) -> float:
    return sum(float(np.sum(error[k] ** 2)) for error, k in zip(errors, kept, strict=True))
