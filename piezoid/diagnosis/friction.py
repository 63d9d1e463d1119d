"""The friction states of the envelope, and what a history leaves in them."""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.friction import friction_states

FRICTION = np.geomspace(0.05, 3.0, 8)  # how far the drive goes until a friction state forgot


def rubbed(drive: Array, turns: Sequence[float]) -> Array:
    """Return the friction states after a drive turned at these values before the first sample."""
    way = np.array([*turns, float(drive[0])])
    return np.asarray(friction_states(way, FRICTION, np.zeros(len(FRICTION)))[-1])
