"""The same fit with fewer parts: kinks are held back as much as the data allow, idle ones go.

A kink is by how much the slope changes at a threshold: the weight of a play, a bend of Psi. Each
in turn, the cheapest first, is set to zero in the fit linearised about its end, which raises the
sum of squares by

    v_k^2 / (K C K')_kk,     v = K x + c the kinks, C = (J'J + ridge N K'K)^-1

and moves all other weights and slopes to where they are best without it. [Hassibi & Stork 1993]
What remains is fitted once more, and kept if it is as good; else half as much is taken out.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Scaled,
    operator_of,
    vector_of,
)
from piezoid.identification.hysteresis.gauss_newton import Task, minimise
from piezoid.identification.hysteresis.jackknife import Grams, grams_of
from piezoid.identification.hysteresis.ridge import chosen_ridge
from piezoid.identification.hysteresis.search import Fitted
from piezoid.numerics.arrays import Array

NO_WORSE = 1.01  # times the rms of the fit with all parts: half of what an order may cost
NOTHING = 1e-9  # a kink that is none
FIXED = ("gap", "below_gap", "above_gap", "lag")  # what the linearised fit says little of


def simplified(fitted: Fitted, *, iterations: int) -> Fitted:
    """Return the fit with its kinks held back and the idle ones gone, if it is as good."""
    theta, task = fitted.minimum.theta, fitted.task
    grams = grams_of(theta, task)
    lower, upper = task.coordinates.bounds(task.longest_lag_s)
    free = (theta > lower + 1e-9) & (theta < upper - 1e-9)
    free &= grams.normal.sum(axis=0).diagonal() > 0.0
    for name in FIXED:
        free[task.coordinates.slices[name]] = False
    task = replace(task, ridge=chosen_ridge(theta, task, grams, free))
    held = _step(theta, task, grams, free)
    limit = NO_WORSE * fitted.minimum.rms
    order = _removable(held, task, grams, free)
    half = order[: len(order) // 2]
    for without, ridge in ((order, task.ridge), (half, fitted.task.ridge)):
        moved = without[-1][1] if without else held
        gone = {kink for kink, _ in without}
        found = _refitted(fitted, moved, gone, replace(task, ridge=ridge), iterations)
        if found.minimum.rms <= limit:
            return found
    return fitted


def _step(theta: Array, task: Task, grams: Grams, free: NDArray[np.bool_]) -> Array:
    """Return where the linearised fit ends with the ridge of the task."""
    kinks, constant = task.prior
    normal = (grams.normal.sum(axis=0) + kinks.T @ kinks)[np.ix_(free, free)]
    gradient = grams.gradient.sum(axis=0) + kinks.T @ (kinks @ theta + constant)
    moved = theta.copy()
    moved[free] -= _inverse(normal) @ gradient[free]
    return np.asarray(np.clip(moved, *task.coordinates.bounds(task.longest_lag_s)))


def _removable(
    theta: Array, task: Task, grams: Grams, free: NDArray[np.bool_]
) -> list[tuple[int, Array]]:
    """Return kinks that may go, the cheapest first, and where the fit is without them so far."""
    kinks, constant = task.coordinates.kinks()
    prior, _ = task.prior
    inverse = _inverse((grams.normal.sum(axis=0) + prior.T @ prior)[np.ix_(free, free)])
    size, rows = kinks @ theta + constant, kinks[:, free]
    left = list(range(_removable_count(task.coordinates)))
    room = (NO_WORSE - 1.0) * grams.square.sum()  # of the squares: half of it for what is linear
    found, moved = [], theta
    while left:
        spread = np.einsum("ki,ij,kj->k", rows, inverse, rows)
        cost = np.where(
            np.abs(size) < NOTHING, 0.0, size**2 / np.where(spread > 0.0, spread, 1e-300)
        )
        least = min(left, key=lambda kink: cost[kink])
        room -= cost[least]
        if room < 0.0:
            break
        left.remove(least)
        if spread[least] > 0.0 and cost[least] > 0.0:
            column = inverse @ rows[least]
            moved = moved.copy()
            moved[free] -= column * (size[least] / spread[least])
            size = size - rows @ column * (size[least] / spread[least])
            inverse = inverse - np.outer(column, column) / spread[least]
        found.append((least, moved))
    return found


def _removable_count(coordinates: Coordinates) -> int:
    """Return how many kinks have thresholds of their own: those of gamma stand at even places."""
    shape = coordinates.shape
    return shape.plays + shape.below + shape.above


def _inverse(normal: Array) -> Array:
    scale = np.sqrt(np.diag(normal))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))


def _refitted(
    fitted: Fitted, theta: Array, without: set[int], task: Task, iterations: int
) -> Fitted:
    """Fit what remains, from the vector ``theta`` with some of its kinks taken out."""
    old = task.coordinates
    operator = _without(operator_of(theta, old), without, old)
    shape = replace(
        old.shape,
        plays=len(operator.gap),
        below=operator.zero,
        above=len(operator.knot) - operator.zero - 1,
    )
    fresh = replace(task, coordinates=Coordinates(shape=shape, offsets=old.offsets))
    begun = vector_of(operator, fresh.coordinates)
    for index in range(len(old.offsets)):
        begun[fresh.coordinates.offset_slice(index)] = theta[old.offset_slice(index)]
        begun[fresh.coordinates.memory_slice(index)] = _memory(theta, old, operator, index)
    begun = fresh.coordinates.within_reach(begun, fresh.swing)
    return replace(fitted, task=fresh, minimum=minimise(begun, fresh, iterations=iterations))


def _memory(theta: Array, coordinates: Coordinates, operator: Scaled, index: int) -> Array:
    """Return memory slopes for the remaining plays that give them the states they had."""
    old = operator_of(theta, coordinates)
    slopes = theta[coordinates.memory_slice(index)]
    curve = np.concatenate([[0.0], np.cumsum(old.gap * slopes)])
    radius = np.concatenate([[0.0], old.threshold])
    state = np.interp(operator.threshold, radius, curve)
    return np.asarray(np.clip(np.diff(state, prepend=0.0) / operator.gap, -1.0, 1.0))


def _without(operator: Scaled, kinks: set[int], coordinates: Coordinates) -> Scaled:
    """Return the operator without these kinks, numbered as ``Coordinates.kinks`` does."""
    plays, below = coordinates.shape.plays, coordinates.shape.below
    moving = np.array([i for i in range(plays) if i not in kinks], dtype=np.intp)
    zero = operator.zero
    gone = {zero - 1 - (k - plays) for k in kinks if plays <= k < plays + below}
    gone |= {zero + 1 + (k - plays - below) for k in kinks if k >= plays + below}
    kept = np.array([j for j in range(len(operator.knot)) if j not in gone], dtype=np.intp)
    centre = int(np.searchsorted(kept, zero))
    threshold = operator.threshold[moving]
    return replace(
        operator,
        gap=np.diff(threshold, prepend=0.0),
        threshold=threshold,
        weight=operator.weight[np.concatenate([[0], moving + 1])],
        knot=operator.knot[kept],
        slope=np.concatenate(
            [operator.slope[kept[: centre + 1]], operator.slope[kept[centre:] + 1]]
        ),
        zero=centre,
    )
