"""Laws defined by a differential equation in the field: one state, one slope per direction.

    dz/dE = slope(E, z, s),      s = +1 rising, -1 falling

Between two turning points the field replaces the time. A branch is integrated [classical
Runge-Kutta] on a grid that depends only on its ends, with cubic interpolation between grid points,
so that the state does not depend on the sampling of the path.
"""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.branches import branches, settled

# (field, state, sign) -> dz/dE
Slope = Callable[[float, float, float], float]

STEP = 0.02  # of the field: the error of a whole loop is then below 1e-7 of it


def states_along(slope: Slope, path: Array, start: float, *, jumps: Sequence[float] = ()) -> Array:
    """Return the state along a path of fields.

    start  state at the path's first point
    jumps  fields at which the slope jumps; no step crosses one
    """
    from scipy.interpolate import CubicHermiteSpline

    path = settled(path)
    states = np.full_like(path, start)
    for first, last, rising in branches(path):
        sign = 1.0 if rising else -1.0
        travelled, state = [0.0], [float(states[first])]
        drift: list[float] = []
        begun = float(path[first])
        edges = _edges(begun, float(path[last]), jumps)
        curve = np.empty(last + 1 - first)
        way = sign * (path[first : last + 1] - begun)
        for low, high in edges:
            travelled, state, drift = _integrated(slope, low, high, state[-1])
            inside = (way >= abs(low - begun)) & (way <= abs(high - begun))
            spline = CubicHermiteSpline(travelled, state, drift)
            curve[inside] = spline(way[inside] - abs(low - begun))
        states[first + 1 : last + 1] = curve[1:]
        states[last] = state[-1]
    return states


def _edges(begin: float, end: float, jumps: Sequence[float]) -> list[tuple[float, float]]:
    inside = sorted(j for j in jumps if min(begin, end) < j < max(begin, end))
    stops = [begin, *(inside if end > begin else inside[::-1]), end]
    return list(itertools.pairwise(stops))


def _integrated(
    slope: Slope, begin: float, end: float, state: float
) -> tuple[list[float], list[float], list[float]]:
    """Return distances along the branch, states, and their derivatives by distance."""
    sign = 1.0 if end > begin else -1.0
    steps = max(math.ceil(abs(end - begin) / STEP), 1)
    step = (end - begin) / steps
    # a hair inside the ends: there the slope is that of this piece
    hair = 1e-12 * (end - begin)
    travelled, states, growth = [0.0], [state], [sign * slope(begin + hair, state, sign)]
    for k in range(steps):
        field = begin + k * step
        one = sign * growth[-1]
        two = slope(field + 0.5 * step, state + 0.5 * step * one, sign)
        three = slope(field + 0.5 * step, state + 0.5 * step * two, sign)
        last = field + step - (hair if k == steps - 1 else 0.0)
        four = slope(last, state + step * three, sign)
        state += step * (one + 2.0 * two + 2.0 * three + four) / 6.0
        travelled.append(abs(step) * (k + 1))
        states.append(state)
        growth.append(sign * slope(last, state, sign))
    return travelled, states, growth
