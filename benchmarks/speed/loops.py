"""Straightforward versions of the operators: NumPy sample by sample, and numba.

The numba versions have the plays in the innermost loop, which is vectorised, one pass over the
samples, and additions in any order. The inverse loops return the voltage only. The inverse of
piezoid also updates the forward memory.
"""

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

NO_NUMBA = "numba is not installed, so its figures are missing: pip install piezoid[benchmarks]."
Zones = tuple[Array, Array, int]  # thresholds, weights, index of the threshold 0


def numpy_bank(u: Array, threshold: Array) -> Array:
    """Return the states of the plays, (samples, plays), all plays of a sample at once."""
    z = np.zeros(len(threshold))
    columns = np.empty((len(u), len(threshold)))
    for k, value in enumerate(u):
        z = np.minimum(np.maximum(z, value - threshold), value + threshold)
        columns[k] = z
    return columns


def numpy_sum(u: Array, plays: PrandtlIshlinskii, memory: Array) -> Array:
    """Return the sum of the plays, sample by sample."""
    z, r, w = np.array(memory), plays.threshold, plays.weight
    out = np.empty(len(u))
    for k, value in enumerate(u):
        z = np.minimum(np.maximum(z, value - r), value + r)
        out[k] = w @ z
    return out


def numpy_zones(h: Array, zones: DeadZones) -> Array:
    """Return the sum of the dead zones, sample by sample."""
    r, w = zones.threshold, zones.weight
    low, high = np.where(r < 0, -np.inf, 0.0), np.where(r > 0, np.inf, 0.0)
    low[r == 0], high[r == 0] = -np.inf, np.inf
    out = np.empty(len(h))
    for k, value in enumerate(h):
        out[k] = w @ np.minimum(np.maximum(value - r, low), high)
    return out


def numpy_forward(u: Array, model: ModifiedPrandtlIshlinskii) -> Array:
    """Return the model's displacement from its virgin memory."""
    return numpy_zones(numpy_sum(u, model.plays, model.virgin_memory()), model.dead_zones)


def numpy_inverse(y: Array, model: ModifiedPrandtlIshlinskii) -> Array:
    """Return the voltage that produces this displacement."""
    q = numpy_zones(y, model.dead_zones.inverse())
    inverse = model.plays.inverse()
    return numpy_sum(q, inverse, model.plays.inverse_memory(model.virgin_memory()))


def _scalar_bank(u: Array, r: Array, columns: Array) -> None:
    z = np.zeros(len(r))
    for k in range(len(u)):
        for i in range(len(r)):
            z[i] = min(max(z[i], u[k] - r[i]), u[k] + r[i])
            columns[k, i] = z[i]


def _scalar_forward(u: Array, r: Array, w: Array, z: Array, zones: Zones, y: Array) -> None:
    knot, weight, zero = zones
    for k in range(len(u)):
        h = 0.0
        for i in range(len(r)):
            z[i] = min(max(z[i], u[k] - r[i]), u[k] + r[i])
            h += w[i] * z[i]
        bent = weight[zero] * h
        for i in range(zero):
            bent += weight[i] * min(h - knot[i], 0.0)
        for i in range(zero + 1, len(knot)):
            bent += weight[i] * max(h - knot[i], 0.0)
        y[k] = bent


def _scalar_inverse(y: Array, r: Array, w: Array, z: Array, zones: Zones, u: Array) -> None:
    knot, weight, zero = zones
    for k in range(len(y)):
        q = weight[zero] * y[k]
        for i in range(zero):
            q += weight[i] * min(y[k] - knot[i], 0.0)
        for i in range(zero + 1, len(knot)):
            q += weight[i] * max(y[k] - knot[i], 0.0)
        total = 0.0
        for i in range(len(r)):
            z[i] = min(max(z[i], q - r[i]), q + r[i])
            total += w[i] * z[i]
        u[k] = total


@cache
def _compiled() -> tuple[Callable[..., Any], ...] | None:
    """Return bank, forward and inverse compiled by numba, or None if it is not installed."""
    if find_spec("numba") is None:
        return None
    import numba

    functions = _scalar_bank, _scalar_forward, _scalar_inverse
    return tuple(numba.njit(function, fastmath=True) for function in functions)


def numba_bank(u: Array, threshold: Array, order: Literal["C", "F"]) -> Array | None:
    """Return the states of the plays by numba, row by row or in columns; None without it."""
    functions = _compiled()
    if functions is None:
        return None
    columns = np.empty((len(u), len(threshold)), order=order)
    functions[0](u, threshold, columns)
    return columns


def numba_forward(u: Array, model: ModifiedPrandtlIshlinskii) -> Array | None:
    """Return the model's displacement by numba; None without it."""
    functions = _compiled()
    if functions is None:
        return None
    plays, y = model.plays, np.empty(len(u))
    memory = np.array(model.virgin_memory())
    functions[1](u, plays.threshold, plays.weight, memory, zones_of(model.dead_zones), y)
    return y


def numba_inverse(y: Array, model: ModifiedPrandtlIshlinskii) -> Array | None:
    """Return the voltage that produces this displacement by numba; None without it."""
    functions = _compiled()
    if functions is None:
        return None
    plays, u = model.plays.inverse(), np.empty(len(y))
    memory = np.array(model.plays.inverse_memory(model.virgin_memory()))
    functions[2](y, plays.threshold, plays.weight, memory, zones_of(model.dead_zones.inverse()), u)
    return u


def zones_of(zones: DeadZones) -> Zones:
    """Return thresholds, weights and the index of the zone of threshold 0."""
    return zones.threshold, zones.weight, zones.zero
