"""A ladder of first-order filters side by side, as creep is made of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous


def ladder(
    signal: Array,
    coefficients: Sequence[tuple[float, float, float]],
    share: ArrayLike = 1.0,
) -> Array:
    """Return the sum of what filters make of one signal that was steady before.

        y[k] = sum_i c_i y_i[k],    y_i[k] = p_i y_i[k-1] + b0_i x[k] + b1_i x[k-1]

    signal        (samples,)
    coefficients  (rungs,)    p, b0, b1 of each, all of gain one: (b0 + b1) / (1 - p) = 1
    share         (rungs,)    c, or one for all
    returned      (samples,)  of the signal's unit; zeros without rungs
    """
    given = contiguous(signal)
    found = np.empty_like(given)
    pole, b0, b1 = np.array(coefficients, dtype=np.float64).reshape(-1, 3).T.copy()
    part = np.broadcast_to(np.asarray(share, dtype=np.float64), pole.shape)
    b0, b1 = b0 * part, b1 * part
    KERNELS.pk_ladder(
        len(given),
        address(given),
        len(pole),
        address(pole),
        address(b0),
        address(b1),
        address(part * given[:1].sum()),
        address(found),
    )
    return found
