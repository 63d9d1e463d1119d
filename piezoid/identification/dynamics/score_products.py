"""Sums of products of scores, for covariances that hold although the scores are not independent.

    covariance = C^-1 M C^-1,   M = sum of products of what counts as one draw    [White 1982]

A score is a whitened derivative times the whitened residual at one sample, (parameters, samples).
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.quantiles import NORMAL_95

NEIGHBOURS = 30  # samples over which whitened noise may still be correlated
PARTS = 12  # of a recording
STUDENT = 2.2010  # quantile of eleven degrees of freedom, 95 %, where a normal one is taken


def over_neighbours(scores: Array) -> Array:
    """Return the sum of products with neighbours, falling with distance [Newey & West 1987].

    It sees noise that changes in time. Weights 1 - lag / n are those of sums over n neighbours:
    sum_t S_t S_t^T / n.
    """
    edges = np.zeros((len(scores), NEIGHBOURS))
    running = np.cumsum(np.concatenate([edges, scores, edges], axis=1), axis=1)
    sums = running[:, NEIGHBOURS:] - running[:, :-NEIGHBOURS]
    return np.asarray(sums @ sums.T / NEIGHBOURS)


def over_parts(scores: Array) -> Array:
    """Return the sum of products of whole parts of the recording, each of them one draw.

    What an operator does not follow repeats from cycle to cycle and only changes as the drive
    sweeps on, so that cycles are no draws; parts are. So few know their own spread poorly, hence
    Student's quantile.
    """
    edges = np.linspace(0, scores.shape[1], PARTS + 1).astype(np.int64)[:-1]
    sums = np.add.reduceat(scores, edges, axis=1)
    return np.asarray(sums @ sums.T * PARTS / (PARTS - 1) * (STUDENT / NORMAL_95) ** 2)
