"""The triangular factor of a tall least-squares problem, gathered chunk by chunk.

All that least squares needs to know of a million rows [J | e] is the small triangle R of their QR
factorisation: |J x + e|^2 = |R (x, 1)|^2. Gathering R block by block keeps memory constant and,
unlike the Gram matrix J'J, does not square the condition number, which for play regressors
reaches 2e7.
"""

from typing import cast

import numpy as np
from scipy.linalg import lapack

from piezoid.numerics.arrays import Array


def empty_triangle(columns: int) -> Array:
    """Return the factor of no rows at all, (0, columns)."""
    return np.empty((0, columns), order="F")


def gather(triangle: Array, rows: Array) -> Array:
    """Return the triangular factor of the rows seen so far and these.

    triangle  (<= columns, columns)  from ``empty_triangle`` or ``gather``
    rows      (samples, columns)
    returned  (min(seen, columns), columns), upper triangular
    """
    stacked = np.empty((len(triangle) + len(rows), rows.shape[1]), order="F")
    stacked[: len(triangle)] = triangle
    stacked[len(triangle) :] = rows
    factored = cast(Array, lapack.dgeqrf(stacked, overwrite_a=1)[0])
    return np.asfortranarray(np.triu(factored[: rows.shape[1]]))
