"""Switching states: walls that switch about a field of their own, and forget gradually.

    dx = (1 - x) dF   where the drive rises,   dx = (1 + x) dG   where it falls
    F = (s / 2) erf((u - a) / w),              G = (s / 2) erf((u - b) / w)

Rising past the field a, a part 1 - exp(-s) of what is not yet up switches up; falling past b,
likewise down: Duhem's operator with switching densities of Gaussian shape. Unlike a play or a
friction state it forgets by where the drive was, not by how far it went, and its minor loops move
before they close.

Source: Duhem, Z. Phys. Chem. 22 (1897); Macki, Nistri & Zecca, SIAM Rev. 35 (1993) 94; Lin & Lin,
Comput. Math. Appl. 64 (2012) 766.
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

MOST_FIELDS = 8  # PK_FIELDS of the kernel


def switching_states(
    drive: Array, up: Array, down: Array, start: Array, *, passage: float, width: float
) -> Array:
    """Follow a state for every pair of an upper and a lower field along a drive.

    drive     (samples,)         of any unit
    up        (rising,)          a, of the drive's unit
    down      (falling,)         b, of the drive's unit; at most eight fields in all
    start     (states,)          x at the first sample, the state of up i and down j at
                                 ``len(down) * i + j``
    passage   s, how often a whole passage of a field divides by e what has not switched
    width     w, of the drive's unit, > 0
    returned  (samples, states)  between -1 and 1 where the start is, column-major

    Raises ``ValueError`` for more than eight fields.

    >>> rising = np.array([-2.0, 2.0])
    >>> x = switching_states(rising, np.array([0.5]), np.array([-0.5]), np.array([-1.0]),
    ...                      passage=2.0, width=0.3)
    >>> print(x[-1].round(3))  # 1 - 2 exp(-2)
    [0.729]
    """
    if len(up) + len(down) > MOST_FIELDS:
        raise ValueError(f"found {len(up) + len(down)} fields, but at most {MOST_FIELDS} fit")
    given, state = contiguous(drive), np.array(start, dtype=np.float64)
    states = np.empty((len(given), len(up) * len(down)), order="F")
    KERNELS.pk_switching(
        len(given),
        address(given),
        len(up),
        address(contiguous(up)),
        len(down),
        address(contiguous(down)),
        passage,
        width,
        address(state),
        len(given),
        address(states),
    )
    return states
