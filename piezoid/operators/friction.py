"""Friction states: they forget exponentially with the way the drive went.

    dx/dt = du/dt - |du/dt| x / r

Source: Dahl, Aerospace Corporation TR-0158 (1968).
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous


def friction_states(drive: Array, reach: Array, start: Array) -> Array:
    """Follow friction along a drive; over a straight part x goes to r sgn(du) by exp(-|du| / r).

    drive     (samples,)         of any unit
    reach     (states,)          r, of the drive's unit, > 0
    start     (states,)          x at the first sample
    returned  (samples, states)  of the drive's unit, column-major
    """
    given, state = contiguous(drive), np.array(start, dtype=np.float64)
    states = np.empty((len(given), len(state)), order="F")
    KERNELS.pk_friction(
        len(given),
        address(given),
        len(state),
        address(contiguous(reach)),
        address(state),
        len(given),
        address(states),
    )
    return states
