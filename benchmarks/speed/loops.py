"""The operators as one would write them oneself: NumPy sample by sample, and numba.

Plays, model and inverse as in their definitions. The inverse loops return the voltage alone; ours
follows the forward memory besides.
"""

from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

NO_NUMBA = "numba is not installed, so its column is empty: pip install piezoid[benchmarks]."


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
    """Return the voltage that makes this displacement."""
    q = numpy_zones(y, model.dead_zones.inverse())
    inverse = model.plays.inverse()
    return numpy_sum(q, inverse, model.plays.inverse_memory(model.virgin_memory()))


def _scalar_bank(u: Array, r: Array, columns: Array) -> None:
    for i in range(len(r)):
        z = 0.0
        for k in range(len(u)):
            z = min(max(z, u[k] - r[i]), u[k] + r[i])
            columns[k, i] = z


def _scalar_sum(u: Array, r: Array, w: Array, z: Array, out: Array) -> None:
    for k in range(len(u)):
        total = 0.0
        for i in range(len(r)):
            z[i] = min(max(z[i], u[k] - r[i]), u[k] + r[i])
            total += w[i] * z[i]
        out[k] = total


def _scalar_zones(h: Array, r: Array, w: Array, out: Array) -> None:
    for k in range(len(h)):
        total = 0.0
        for i in range(len(r)):
            away = h[k] - r[i]
            if r[i] == 0.0 or (r[i] > 0.0) == (away > 0.0):
                total += w[i] * away
        out[k] = total


@cache
def _compiled() -> tuple[Callable[..., Any], ...] | None:
    """Return bank, sum and zones through numba, or None where it is not installed."""
    if find_spec("numba") is None:
        return None
    import numba

    return tuple(numba.njit(one) for one in (_scalar_bank, _scalar_sum, _scalar_zones))


def numba_bank(u: Array, threshold: Array) -> Array | None:
    """Return the states of the plays by numba, column after column; None without it."""
    found = _compiled()
    if found is None:
        return None
    columns = np.empty((len(u), len(threshold)), order="F")
    found[0](u, threshold, columns)
    return columns


def numba_forward(u: Array, model: ModifiedPrandtlIshlinskii) -> Array | None:
    """Return the model's displacement by numba; None without it."""
    found = _compiled()
    if found is None:
        return None
    plays, zones = model.plays, model.dead_zones
    h, y = np.empty(len(u)), np.empty(len(u))
    found[1](u, plays.threshold, plays.weight, np.array(model.virgin_memory()), h)
    found[2](h, zones.threshold, zones.weight, y)
    return y


def numba_inverse(y: Array, model: ModifiedPrandtlIshlinskii) -> Array | None:
    """Return the voltage that makes this displacement by numba; None without it."""
    found = _compiled()
    if found is None:
        return None
    plays, zones = model.plays.inverse(), model.dead_zones.inverse()
    memory = np.array(model.plays.inverse_memory(model.virgin_memory()))
    q, u = np.empty(len(y)), np.empty(len(y))
    found[2](y, zones.threshold, zones.weight, q)
    found[1](q, plays.threshold, plays.weight, memory, u)
    return u
