"""The least of a convex quadratic form within bounds, whole sets of bounds changed at once."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from piezoid.numerics.arrays import Array

ROUNDS = 500
PATIENCE = 3  # rounds of whole sets without progress; then one at a time, which always ends
ROUNDING = 1e-12  # of the largest number that a difference was made of

Chosen = NDArray[np.bool_]


def bounded_minimum(gram: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Minimise x' G x / 2 - b' x with l <= x <= u by block principal pivoting.

    G, b  (numbers, numbers), (numbers,)  G positive definite
    l, u  (numbers,)  l <= u; equal bounds fix a number

    Nothing is small or large by itself: b and the bounds in other units give x in other units.

    Source: Portugal, Judice & Vicente, Mathematics of Computation 63 (1994). What goes wrong: a G
    that is not definite to rounding; whoever damps it avoids that. Columns of very different
    size: rounding is judged by the largest.
    """
    # Where a search stands on a bound, it mostly stays there: a step begins at 0.
    at_lower = (upper <= lower) | ((lower == 0.0) & (right < 0.0))
    at_upper = (upper == 0.0) & (right > 0.0) & ~at_lower
    fewest, patience, steepest = len(right) + 1, PATIENCE, _largest(np.diag(gram))
    x = np.clip(np.zeros_like(right), lower, upper)
    for _ in range(ROUNDS):
        x = _solved(gram, right, np.where(at_lower, lower, upper), ~(at_lower | at_upper))
        slope, flat = gram @ x - right, ROUNDING * max(_largest(right), steepest * _largest(x))
        below, above = _outside(x, lower, upper, at_lower | at_upper)
        inwards = (at_lower & (slope < -flat) & (upper > lower)) | (at_upper & (slope > flat))
        wrong = below | above | inwards
        count = int(np.count_nonzero(wrong))
        if count == 0:
            break
        if count < fewest:
            fewest, patience = count, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            last = int(np.flatnonzero(wrong)[-1])
            wrong = np.arange(len(x)) == last
        at_lower = (at_lower & ~(inwards & wrong)) | (below & wrong)
        at_upper = (at_upper & ~(inwards & wrong)) | (above & wrong)
    return np.clip(x, lower, upper)


def _largest(numbers: Array) -> float:
    return float(np.abs(numbers).max(initial=0.0))


def _outside(x: Array, lower: Array, upper: Array, held: Chosen) -> tuple[Chosen, Chosen]:
    slack = ROUNDING * _largest(x)
    return ~held & (x < lower - slack), ~held & (x > upper + slack)


def _solved(gram: Array, right: Array, bound: Array, free: Chosen) -> Array:
    x = np.where(free, 0.0, bound)
    place = np.flatnonzero(free)
    if len(place):
        against = right[place] - gram[place] @ x
        _, found, wrong = lapack.dposv(gram[place[:, None], place], against)
        if wrong:
            raise np.linalg.LinAlgError("the quadratic form is not definite to rounding")
        x[place] = found
    return np.asarray(x)
