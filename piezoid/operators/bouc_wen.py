"""Bouc-Wen state: smooth saturation, with minor loops that do not close.

    dz/du = 1 - |z|^n (gamma + beta sgn(z du))

Source: Bouc (1967); Wen, J. Eng. Mech. 102 (1976).
"""

import numpy as np
from numpy.typing import ArrayLike

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

MAX_STEP = 0.01  # of the drive; the error of the midpoint rule is then some 1e-5 of the state


def bouc_wen_states(
    drive: Array,
    beta: ArrayLike,
    gamma: ArrayLike,
    exponent: ArrayLike,
    start: ArrayLike = 0.0,
) -> Array:
    """Return one or several Bouc-Wen states along a drive.

    drive            (samples,)            of the order of one
    beta, gamma      scalars or (states,)  loading and unloading; 1 / unit of the drive^n
    exponent         scalar or (states,)   n >= 1, sharpness of the knee
    start            scalar or (states,)   z at the first sample
    returned         (samples,) or (samples, states)  unit of the drive
    """
    numbers = np.broadcast_arrays(*(np.asarray(x, float) for x in (beta, gamma, exponent, start)))
    law, state = np.stack(numbers[:3], axis=-1), contiguous(numbers[3].ravel()).copy()
    drive = contiguous(drive)
    states = np.empty((len(drive), len(state)))
    KERNELS.pk_bouc_wen(
        len(drive),
        address(drive),
        len(state),
        address(contiguous(law)),
        MAX_STEP,
        address(state),
        address(states),
    )
    return states if numbers[0].ndim else states[:, 0]
