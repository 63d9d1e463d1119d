"""Friction states, which decay exponentially with the distance travelled by the drive.

    dx/dt = d(u^n)/dt - |du/dt| x / r

n = 1 is Dahl's friction. Domain walls with an anhysteretic curve A(u) obey the same law with A in
place of u^n; the powers are the first terms of the series of A.

Source: Dahl, Aerospace Corporation TR-0158 (1968); Jiles & Atherton, J. Magn. Magn. Mater. 61
(1986); Coleman & Hodgdon, Int. J. Eng. Sci. 24 (1986).
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

POWERS = (1, 2, 3)


def friction_states(
    drive: Array, reach: Array, start: Array, *, power: Array | None = None
) -> Array:
    """Return friction states along a drive.

    Between samples a state relaxes exponentially to

        q_1 = s r,   q_2 = 2 s r u - 2 r^2,   q_3 = 3 s r u^2 - 6 r^2 u + 6 s r^3,   s = sgn(du)

    drive     (samples,)         any unit
    reach     (states,)          r, unit of the drive, > 0
    start     (states,)          x at the first sample
    power     (states,)          n, 1 to 3; None: all 1
    returned  (samples, states)  unit of the drive^n, column-major
    """
    powers = np.ones(len(reach)) if power is None else contiguous(power)
    if not np.isin(powers, POWERS).all():
        raise ValueError(f"powers are {np.unique(powers)}, expected some of {POWERS}")
    order = np.argsort(reach, kind="stable")  # states of equal reach share an exponential
    u, state = contiguous(drive), np.array(start, dtype=np.float64)[order]
    states = np.empty((len(u), len(state)), order="F")
    KERNELS.pk_friction(
        len(u),
        address(u),
        len(state),
        address(contiguous(reach)[order]),
        address(powers[order]),
        address(order.astype(np.float64)),
        address(state),
        len(u),
        address(states),
    )
    return states
