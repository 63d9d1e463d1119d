"""Whether a smaller model is as good as the best: within the uncertainty of the difference.

    sum_b d_b <= (c^2 - 1) sum_b E_b + se,     d_b = e_b - E_b
    se^2 = B/(B-1) sum_b (d_b - mean d)^2

e_b and E_b are the sums of squares that the smaller and the best leave in block b of B of the same
rows. The differences are paired: noise that both leave is no part of their standard error. It is
the one-standard-error rule with a share c below which nobody would want more numbers.
[Breiman et al. 1984, 3.4.3; Hastie et al. 2009, 7.10]
"""

import numpy as np

from piezoid.numerics.arrays import Array

BLOCKS = 24


def is_as_good(smaller: Array, best: Array, close: float) -> bool:
    """Tell whether blocks of squares are within ``close`` and a standard error of the best.

    smaller, best  (blocks,)
    close          ratio of rms that makes no difference
    """
    apart, count = smaller - best, len(smaller)
    doubt = np.sqrt(count / max(count - 1, 1)) * np.linalg.norm(apart - apart.mean())
    return bool(apart.sum() <= (close**2 - 1.0) * best.sum() + doubt)


def blocks_of_squares(residual: Array) -> Array:
    """Return the squares of a residual summed over stretches of time, (blocks,)."""
    return np.array([float(part @ part) for part in np.array_split(residual, BLOCKS)])
