"""The search over everything at once, and the same on the rows kept of each fold.

The rows are many and the numbers few, so normal equations are formed once for every step. On a
fold the columns of the whole search serve again: only the error is new (a chord step), and what is
left out has no say.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.joint.chain import follow, residual
from piezoid.identification.joint.parts import FOLDS, Part
from piezoid.identification.joint.tangents import tangents_of
from piezoid.identification.joint.vector import State
from piezoid.numerics.arrays import Array
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise
from piezoid.numerics.once import Once

CONVERGED = 1e-4
# On the rows kept: three chords, at first nearly undamped; where none helps, the fold has no say.
CHORDS = Rule(tolerance=0.0, iterations=3, tries=4, damping=1e-6, easier=1.0, harder=100.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """Where a search ended.

    state  there
    rms    of the residual at all rows, scaled
    held   (rows,)  residual at the rows left out, fold after fold
    rows   rows of all parts
    folds  (folds, numbers)  the vectors of the folds
    converged  whether the search ended of itself
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


@dataclass(frozen=True, eq=False)
class _Point:
    """A state, and the residual of every part there."""

    state: State
    parts: Sequence[Part]

    @Once
    def errors(self) -> list[Array]:
        return [residual(self.state, k, part) for k, part in enumerate(self.parts)]

    @Once
    def tangents(self) -> list[Array]:
        state = self.state
        return [tangents_of(state, k, p, follow(state, k, p)) for k, p in enumerate(self.parts)]

    @property
    def squares(self) -> float:
        """Return the sum of squares at all rows."""
        return sum(float(error @ error) for error in self.errors)

    @property
    def cost(self) -> float:
        return self.squares + _prior_cost(self.state)

    def linearised(self) -> NormalEquations:
        rows, errors = self.tangents, self.errors
        gram = sum((part.T @ part for part in rows), np.zeros((1, 1)))
        pairs = zip(rows, errors, strict=True)
        slope = sum((part.T @ error for part, error in pairs), np.zeros(1))
        return _with_prior(self.state, gram, slope, self.cost)


@dataclass(frozen=True, eq=False)
class _OnFold:
    """The same on the rows kept of a fold, with the columns of the whole search's end."""

    point: _Point
    kept: Sequence[Array]
    columns: Sequence[Array]
    gram: Array

    @property
    def left(self) -> list[Array]:
        return [error[k] for error, k in zip(self.point.errors, self.kept, strict=True)]

    @property
    def cost(self) -> float:
        return sum(float(np.sum(e**2)) for e in self.left) + _prior_cost(self.point.state)

    def linearised(self) -> NormalEquations:
        pairs = zip(self.columns, self.left, strict=True)
        slope = sum((part.T @ error for part, error in pairs), np.zeros(1))
        return _with_prior(self.point.state, self.gram, slope, self.cost)


def search(state: State, parts: Sequence[Part], *, longest_lag_s: float, steps: int) -> Reached:
    """Search from a point for the least error, then repeat it on the rows kept of each fold."""
    bounds = state.bounds(longest_lag_s)
    found = minimise(
        lambda vector: _Point(state.at(vector), parts),
        state.vector,
        bounds,
        rule=Rule(tolerance=CONVERGED, iterations=steps, tries=8, damping=1e-4),
    )
    end = found.point
    folds = [_on_fold(fold, end, bounds) for fold in range(FOLDS)]
    count = sum(len(error) for error in end.errors)
    return Reached(
        state=end.state,
        rms=float(np.sqrt(end.squares / count)),
        held=np.concatenate([error for _, left_out in folds for error in left_out]),
        rows=count,
        folds=np.array([vector for vector, _ in folds]),
        converged=found.converged,
    )


def _on_fold(fold: int, end: _Point, bounds: tuple[Array, Array]) -> tuple[Array, list[Array]]:
    """Return where a few chords on the rows kept lead, and the residual at the rows left out."""
    kept = [part.fold != fold for part in end.parts]
    columns = [rows[k] for rows, k in zip(end.tangents, kept, strict=True)]  # megabytes: once
    gram = sum((part.T @ part for part in columns), np.zeros((1, 1)))
    start = end.state.vector

    def at(vector: Array) -> _OnFold:
        known = np.array_equal(vector, start)  # the end's residual is worth a simulation
        point = end if known else _Point(end.state.at(vector), end.parts)
        return _OnFold(point, kept, columns, gram)

    found = minimise(at, start, bounds, rule=CHORDS)
    errors = found.point.point.errors
    return found.x, [error[~k] for error, k in zip(errors, kept, strict=True)]


def _with_prior(state: State, gram: Array, slope: Array, cost: float) -> NormalEquations:
    """Add what is known beforehand, with the weight of one row each."""
    gram, slope = gram.copy(), slope.copy()
    for rows, value, place in _priors(state):
        gram[place, place] += rows.T @ rows
        slope[place] += rows.T @ (rows @ value)
    return NormalEquations(gram=gram, slope=slope, cost=cost)


def _priors(state: State) -> list[tuple[Array, Array, slice]]:
    found = []
    for extension, place in zip(state.extensions, state.slices, strict=True):
        scale = abs(state.scales.displacement_m) if extension.in_metres else 1.0
        found.append((extension.prior() / scale, extension.free().value, place))
    return found


def _prior_cost(state: State) -> float:
    return sum(float(np.sum((rows @ value) ** 2)) for rows, value, _ in _priors(state))
