"""The Bouc-Wen state: a state that saturates smoothly and whose minor loops do not close.

    dz/du = 1 - |z|^n (gamma + beta sgn(z du))

Source: Bouc (1967); Wen, J. Eng. Mech. 102 (1976).
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

LONGEST = 0.01  # step of the drive; the midpoint rule then errs by some 1e-5 of the state


def bouc_wen_states(
    drive: Array, beta: float, gamma: float, exponent: float, start: float = 0.0
) -> Array:
    """Return the state along a drive.

    drive            (samples,)  of the order of one
    beta, gamma      scalars     loading and unloading; 1 / unit of the drive, to the power n
    exponent         scalar      n >= 1, sharpness of the knee
    start            scalar      z at the first sample
    returned         (samples,)  unit of the drive
    """
    drive = contiguous(drive)
    states, state = np.empty_like(drive), np.array([start])
    KERNELS.pk_bouc_wen(
        len(drive), address(drive), beta, gamma, exponent, LONGEST, address(state), address(states)
    )
    return states
