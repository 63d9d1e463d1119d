"""The Bouc-Wen state of the nuisance class: its minor loops do not close and may vary with bias.

    dz/dt = dp/dt - (beta |dp/dt| |z|^(n-1) z + gamma dp/dt |z|^n),    p = u + b u^2 / 2

The scale p bends the drive in front of the hysteresis, as in the generalised Prandtl-Ishlinskii
model; it rises for |b u| < 1.

Source: Bouc (1967); Wen, J. Eng. Mech. Div. 102 (1976); Al Janaideh, Rakheja & Su (2009).
"""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.hysteretic_mode import bouc_wen_states

BoucWenLaw = tuple[float, float, float, float]
"""beta, gamma, n, b"""


def states_under(bouc_wen: BoucWenLaw, reversals: Sequence[float], drive: Array) -> Array:
    """Return the state along a drive that turned at these values before, (samples,)."""
    beta, gamma, exponent, bend = bouc_wen
    way = np.array([*reversals, float(drive[0])])
    start = float(bouc_wen_states(_scaled(way, bend), beta, gamma, exponent)[-1])
    return bouc_wen_states(_scaled(drive, bend), beta, gamma, exponent, start)


def _scaled(drive: Array, bend: float) -> Array:
    return np.asarray(drive * (1.0 + 0.5 * bend * drive))
