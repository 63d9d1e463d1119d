"""Triangular factor of a tall least-squares problem, updated in chunks.

Least squares with a million rows [J | e] needs only the small triangle R of their QR
factorisation: |J x + e|^2 = |R (x, 1)|^2. Updating R block by block keeps memory constant and,
unlike the Gram matrix J'J, does not square the condition number, which reaches 2e7 for play
regressors.
"""

from typing import cast

import numpy as np
from scipy.linalg import lapack

from piezoid.numerics.arrays import Array

BLOCK = 16  # columns reflected together


def empty_triangle(columns: int) -> Array:
    """Return the factor of an empty problem: zeros, (columns, columns)."""
    return np.zeros((columns, columns), order="F")


def gather(triangle: Array, rows: Array, *, spend: bool = False) -> Array:
    """Update a triangular factor with further rows.

    triangle  (columns, columns)  from ``empty_triangle`` or ``gather``
    rows      (samples, columns)
    spend     whether column-major rows may be overwritten
    returned  (columns, columns), upper triangular

    The zeros of the triangle are not accessed.
    """
    columns = len(triangle)
    if triangle.shape != (columns, columns):
        raise ValueError(f"a triangle of shape {triangle.shape}, expected {columns, columns}")
    if not columns or not len(rows):
        return triangle
    block = np.asfortranarray(rows)
    may_overwrite = spend or block is not rows
    factorisation = lapack.dtpqrt(
        0, min(BLOCK, columns), np.asfortranarray(triangle), block, overwrite_b=may_overwrite
    )
    return cast(Array, factorisation[0])
