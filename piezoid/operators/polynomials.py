"""Sum of polynomials of many states, computed without a column for every power."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous


def sum_of_polynomials(
    states: Array, drive: Array, *, scale: Array, power: Array, bias: Array
) -> Array:
    """Return the sum of one polynomial per state, with slopes at zero that depend on the drive.

        y = sum_i z_i (c_i1 + u a_i + u^2 b_i + z_i (c_i2 + z_i (c_i3 + z_i c_i4)))

    z  states * scale  (samples, states)     scale (states,)
    u  drive           (samples,)
    c  power           (<= 4, states)        missing powers are zero
    a, b  bias         (2, states)
    y  returned        (samples,)
    """
    columns = np.asfortranarray(states, dtype=np.float64)
    samples, count = columns.shape
    total = np.zeros(samples)
    powers = np.zeros((4, count))
    powers[: len(power)] = power
    KERNELS.pk_polynomials(
        samples,
        address(contiguous(drive)),
        count,
        samples,
        address(columns),
        address(contiguous(scale)),
        address(powers),
        address(np.array(bias, dtype=np.float64)),
        address(total),
    )
    return total
