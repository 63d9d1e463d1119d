"""Friction: states that forget exponentially with the way the drive went.

    dx/dt = du/dt - |du/dt| x / r

Source: Dahl, Aerospace Corporation TR-0158 (1968).
"""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array

FRICTION = np.geomspace(0.05, 3.0, 8)  # how far the drive goes until a friction state forgot


def rubbed(drive: Array, turns: Sequence[float]) -> Array:
    """Return the friction states after the same history."""
    way = np.array([*turns, float(drive[0])])
    return np.asarray(friction_states(way, np.zeros(len(FRICTION)))[-1])


def friction_states(drive: Array, start: Array) -> Array:
    """Follow the friction states along a drive, (samples, states); the first sample is the start.

    Over a straight part of the drive x goes to r sgn(du) by exp(-|du| / r): a sum of weighted
    parts, rescaled before the weights leave the range of numbers.
    """
    step = np.diff(drive)
    way = np.concatenate([[0.0], np.cumsum(np.abs(step))])
    states = np.empty((len(drive), len(FRICTION)), order="F")
    for j, r in enumerate(FRICTION):
        states[0, j] = start[j]
        first = 0
        while first < len(step):
            last = int(np.searchsorted(way, way[first] + 600.0 * r, side="right")) - 1
            last = min(max(last, first + 1), len(step))
            grown = np.exp((way[first + 1 : last + 1] - way[first]) / r)
            earned = np.sign(step[first:last]) * r * -np.expm1(-np.abs(step[first:last]) / r)
            states[first + 1 : last + 1, j] = (
                states[first, j] + np.cumsum(grown * earned)
            ) / grown
            first = last
    return states
