"""How surely blocks of rows gain: by their mean, by their signs, by the likelihood of all.

Source: Vuong, Econometrica 57 (1989), on sums of squares of blocks.
"""

from math import log, sqrt

import numpy as np

from piezoid.numerics.arrays import Array

TELLING = 0.95  # of what columns explain
FEWEST = 6  # blocks to judge by


def gain_z(gains: Array, explained: Array, gain: float) -> float:
    """Return by how many standard errors blocks gain, by the surest of three tests.

    gains      (blocks,)  sums of squares without less those with the columns
    explained  (blocks,)  what the columns make there: blocks without it can say nothing
    gain       1 - rms with / rms without, of all blocks
    """
    telling = gains[_informative(explained)]
    return max(_mean_z(telling), _sign_z(telling), _ratio_z(gain, len(gains)))


def paired_z(worse: Array, better: Array) -> float:
    """Return by how many standard errors blocks lose less with one thing than with another."""
    return _mean_z(worse - better)


def _informative(explained: Array) -> Array:
    """Return which blocks can say anything: those in which nearly all of the columns lie."""
    order = np.argsort(explained)[::-1]
    total = np.cumsum(explained[order])
    count = int(np.searchsorted(total, TELLING * total[-1])) + 1
    chosen = np.zeros(len(explained), dtype=bool)
    chosen[order[: max(count, FEWEST)]] = True
    return chosen


def _mean_z(gains: Array) -> float:
    """Return the mean over its standard error."""
    return float(gains.sum()) / (float(gains.std(ddof=1)) * sqrt(len(gains)) + 1e-300)


def _sign_z(gains: Array) -> float:
    """Return how surely more than half of the blocks gain: blind to how much, so to outliers."""
    count = len(gains)
    return float(np.sum(gains > 0) - 0.5 * count - 0.5) / (0.5 * sqrt(count))


def _ratio_z(gain: float, blocks: int) -> float:
    """Return the root of the likelihood ratio, 2 n ln(rms0 / rms1), n blocks for n observations.

    What lies in a few blocks only is seen by this one; thousands of rows count as few tens.
    """
    return sqrt(-2.0 * blocks * log(1.0 - gain)) if 0.0 < gain < 1.0 else 0.0
