"""Where the play thresholds should begin: where an over-complete grid puts its weight.

A fit with many plays on a fine grid is convex and finds where the curvature of the loading curve
is; its weights, gathered into the wanted number of groups, are a start from which a search with
few plays does not end beside the best thresholds.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.identification.hysteresis.coordinates import LEAST_GAP, Shape
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.start import kuhnen_start
from piezoid.numerics.arrays import Array

GRID = 39


def gathered_thresholds(pieces: Sequence[Piece], shape: Shape, lag_s: float) -> Array:
    """Return thresholds at the centres of groups of the over-complete fit's weights, from 0."""
    fine = Shape(plays=GRID, below=shape.below, above=shape.above, lag=shape.lag)
    operator = kuhnen_start(pieces, fine, lag_s).operator
    centres = group_centres(operator.threshold, operator.weight[1:], shape.plays)
    ladder = 2 * LEAST_GAP * np.arange(1, shape.plays + 1)
    spread = np.maximum.accumulate(np.maximum(centres - ladder, 0.0)) + ladder
    return np.concatenate([[0.0], spread])


def group_centres(place: Array, weight: Array, groups: int) -> Array:
    """Return the centres of the best partition of weighted places into groups of neighbours.

    min sum_g sum_(i in g) w_i (p_i - c_g)^2, exactly, by dynamic programming over cuts

    place     (places,)  increasing
    weight    (places,)  >= 0
    returned  (groups,)  increasing; groups <= places
    """
    tiny = weight + 1e-6 * (weight.sum() + 1e-300) / len(weight)
    sums = [np.concatenate([[0.0], np.cumsum(tiny * place**k)]) for k in range(3)]
    count = len(place)
    mass, first, second = (s - s[:, None] for s in sums)
    group = np.triu(np.ones((count + 1, count + 1), dtype=bool), 1)
    cost = np.full((count + 1, count + 1), np.inf)
    cost[group] = second[group] - first[group] ** 2 / mass[group]
    best = np.full((groups + 1, count + 1), np.inf)
    cut = np.zeros((groups + 1, count + 1), dtype=int)
    best[0, 0] = 0.0
    for g in range(1, groups + 1):
        options = best[g - 1, :, None] + cost
        cut[g] = options.argmin(axis=0)
        best[g] = options.min(axis=0)
    centres, end = np.empty(groups), count
    for g in range(groups, 0, -1):
        start = cut[g, end]
        centres[g - 1] = (sums[1][end] - sums[1][start]) / (sums[0][end] - sums[0][start])
        end = start
    return centres
