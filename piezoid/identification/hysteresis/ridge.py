"""How strongly kinks are held back: by the error on blocks of time that were left out.

    x(c) = argmin sum_(b not c) |e_b + J_b x|^2 + ridge N |kinks|^2,     E_c = |e_c + J_c x(c)|^2

Everything is linear about the fit, thresholds and lag stay, so no ridge costs a look at the data.
The memory and the zero of a block are fitted to it. Of all strengths that leave as little as the
best, there and in the fit itself, the greatest is taken: kinks that say nothing of what was left
out go.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.gauss_newton import Task
from piezoid.identification.hysteresis.jackknife import TRUNCATED, Grams
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Samples

STRENGTHS = tuple(10.0**k for k in range(-9, -2))  # up to where a kink of 0.1 costs 1e-5
CLOSE = 1.005  # times the least rms: a quarter of what a smaller shape may cost


def chosen_ridge(theta: Array, task: Task, grams: Grams, free: NDArray[np.bool_]) -> float:
    """Return the ridge that holds the kinks as much as the data allow.

    free  (total,)  which numbers may move
    """
    places = np.flatnonzero(free)
    tasks = [replace(task, ridge=ridge) for ridge in STRENGTHS]
    seen = [_squares(theta, one, grams, places) for one in tasks]
    left = [_left_out(theta, one, grams, places) for one in tasks]
    room, least = CLOSE**2 * seen[0], CLOSE**2 * min(left)
    return max(
        one.ridge
        for one, own, other in zip(tasks, seen, left, strict=True)
        if one is tasks[0] or (own <= room and other <= least)
    )


def _squares(theta: Array, task: Task, grams: Grams, places: Samples) -> float:
    """Return the sum of the squares that the fit leaves in all blocks."""
    kinks, constant = task.prior
    data = grams.normal.sum(axis=0)[np.ix_(places, places)]
    slope = grams.gradient.sum(axis=0)[places]
    rough = kinks[:, places]
    pull = slope + rough.T @ (kinks @ theta + constant)
    x = -_solved(data + rough.T @ rough, pull)
    return float(grams.square.sum() + 2.0 * slope @ x + x @ data @ x)


def _left_out(theta: Array, task: Task, grams: Grams, places: Samples) -> float:
    """Return the sum of the squares that the fit without each block leaves in it."""
    kinks, constant = task.prior
    square = np.ix_(places, places)
    normal = grams.normal.sum(axis=0)[square] + (kinks.T @ kinks)[square]
    gradient = grams.gradient.sum(axis=0) + kinks.T @ (kinks @ theta + constant)
    shared = int(np.count_nonzero(places < task.coordinates.shared))
    left = float(grams.square.sum())
    for own, slope in zip(grams.normal, grams.gradient, strict=True):
        seen, slopes = own[square], slope[places]
        x = np.zeros(len(places))
        x[:shared] = -_solved(normal - seen, gradient[places] - slopes)[:shared]
        local = slice(shared, None)
        pull = slopes[local] + seen[local, :shared] @ x[:shared]
        x[local] = -_solved(seen[local, local], pull)
        left += float(2.0 * slopes @ x + x @ seen @ x)
    return left


def _solved(matrix: Array, right: Array) -> Array:
    scale = np.sqrt(np.diag(matrix).clip(min=0.0))
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(matrix / np.outer(scale, scale), right / scale, rcond=TRUNCATED)
    return np.asarray(found[0] / scale)
