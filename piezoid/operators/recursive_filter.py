"""A recursive filter of any order: a fraction in the delay operator, at rest before it begins."""

import numpy as np
from numpy.typing import ArrayLike

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous


def recursive_filter(numerator: ArrayLike, denominator: ArrayLike, signal: Array) -> Array:
    """Return what a fraction in the delay operator makes of a signal that was zero before.

        a_0 y[k] = sum_i b_i x[k-i] - sum_(i>0) a_i y[k-i]       [Oppenheim & Schafer, ch. 6]

    numerator    (zeros + 1,)  b, the newest input first
    denominator  (poles + 1,)  a, a_0 != 0
    signal       (samples,)
    returned     (samples,)

    What goes wrong: poles outside the unit circle make it grow until it is infinite.
    """
    b, a = (np.atleast_1d(np.asarray(part, dtype=np.float64)) for part in (numerator, denominator))
    if not a[0]:
        raise ValueError("denominator begins with 0: the newest output is not determined")
    order = max(len(a), len(b)) - 1
    given = contiguous(signal)
    found = np.empty_like(given)
    KERNELS.pk_filter(
        len(given),
        address(given),
        order,
        address(_padded(b / a[0], order)),
        address(_padded(a / a[0], order)),
        address(np.zeros(order + 1)),
        address(found),
    )
    return found


def _padded(coefficients: Array, order: int) -> Array:
    return np.pad(coefficients, (0, order + 1 - len(coefficients)))
