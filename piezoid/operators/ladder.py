"""Parallel first-order filters of one signal (the relaxation ladder of creep)."""

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
    """Return the sum of parallel first-order filters of one signal, at rest before it starts.

        y[k] = sum_i c_i y_i[k],    y_i[k] = p_i y_i[k-1] + b0_i x[k] + b1_i x[k-1]

    signal        (samples,)
    coefficients  (rungs,)    p, b0, b1 of each filter, of unit gain: (b0 + b1) / (1 - p) = 1
    share         (rungs,)    c, or a common value
    returned      (samples,)  unit of the signal; zero without rungs
    """
    source = contiguous(signal)
    output = np.empty_like(source)
    pole, b0, b1 = np.array(coefficients, dtype=np.float64).reshape(-1, 3).T.copy()
    weight = np.broadcast_to(np.asarray(share, dtype=np.float64), pole.shape)
    b0, b1 = b0 * weight, b1 * weight
    KERNELS.pk_ladder(
        len(source),
        address(source),
        len(pole),
        address(pole),
        address(b0),
        address(b1),
        address(weight * source[:1].sum()),
        address(output),
    )
    return output
