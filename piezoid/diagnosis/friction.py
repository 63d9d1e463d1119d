"""The friction states of the nuisance class, and what a history leaves in them."""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.friction import friction_states

FRICTION = np.geomspace(0.05, 3.0, 8)  # how far the drive goes until a friction state forgot
PINNING = FRICTION[2:6]  # likewise of walls that are drawn to a curved anhysteretic,
RESTS = (2.0, 3.0)  # of which these are the powers of the drive beside the first
REACH = np.concatenate([FRICTION, *[PINNING for _ in RESTS]])
POWER = np.concatenate([np.ones(len(FRICTION)), np.repeat(RESTS, len(PINNING))])


def rubbing(drive: Array, first: Array) -> Array:
    """Return all friction states along a drive, (samples, states)."""
    return friction_states(drive, REACH, first, power=POWER)


def rubbed(drive: Array, reversals: Sequence[float]) -> Array:
    """Return the friction states after a drive turned at these values before the first sample."""
    way = np.array([*reversals, float(drive[0])])
    return np.asarray(rubbing(way, np.zeros(len(REACH)))[-1])
