"""Largest difference of two Preisach operators in play form over all histories, computed exactly.

With plays and edges on one lattice both operators have the same states:

    y_t - y_m = sum_i g_i(z_i),   g_i = phi_i of one - phi_i of the other
    |z_i - z_(i-1)| <= r_1,   |z_i| <= max(R - r_i, 0)

for every drive within R that began de-poled or at an end of it. The g_i are linear between lattice
points, and all constraints are differences of whole steps. The extremes lie on the lattice: states
with the same fraction of a step can move together, and the sum changes linearly until they meet
other states. Dynamic programming from the widest play to the narrowest finds the extremes.

Along a branch on which the plays up to some j move, both operators have slopes, and the
incremental gain of one behind the inverse of the other is their ratio. There is one ratio for each
j and each lattice point.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.operators.preisach_plays import PreisachPlays, straight_between

Mask = NDArray[np.bool_]


def farthest_from_line_m(operator: PreisachPlays, slope_m_per_V: float, reach_V: float) -> float:
    """Return sup |y - slope u - c| over all drives within a reach of u_off, for the best c.

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> farthest_from_line_m(straight, 1.0, 2.0)  # one play of half-width 1, of slope 1/2
    0.5
    """
    level_V, allowed = _lattice(operator, reach_V)
    value_m = _values(operator, level_V)
    value_m[0] -= slope_m_per_V * level_V
    return float(_half_range(value_m[None], allowed)[0])


def farthest_apart_m(
    model: PreisachPlays, alternatives: Sequence[PreisachPlays], reach_V: float
) -> Array:
    """Return sup |y - y_model - c| over drives within a reach, for the best c, (alternatives,).

    Raises ``ValueError`` unless all operators have the same lattice.

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> farthest_apart_m(straight, [straight], 2.0)
    array([0.])
    """
    level_V, allowed = _lattice(model, reach_V)
    model_m = _values(model, level_V)
    difference_m = np.array(
        [_values(alternative, level_V) - model_m for alternative in _alike(model, alternatives)]
    )
    return _half_range(difference_m, allowed)


def slope_ratios(
    model: PreisachPlays, alternatives: Sequence[PreisachPlays], reach_V: float
) -> Array:
    """Return the smallest and largest incremental gain of alternatives behind the inverse model.

    returned  (alternatives, 2)

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> slope_ratios(straight, [straight], 2.0)
    array([[1., 1.]])
    """
    level_V, allowed = _lattice(model, reach_V)
    slope = _branch_slopes(_values(model, level_V), allowed)
    ratios = []
    for alternative in _alike(model, alternatives):
        ratio = _branch_slopes(_values(alternative, level_V), allowed) / slope
        ratios.append((np.nanmin(ratio), np.nanmax(ratio)))
    return np.array(ratios)


def _alike(model: PreisachPlays, alternatives: Sequence[PreisachPlays]) -> Sequence[PreisachPlays]:
    for alternative in alternatives:
        if (
            alternative.value_m.shape != model.value_m.shape
            or alternative.step_V != model.step_V
            or not np.array_equal(alternative.edge_V, model.edge_V)
        ):
            raise ValueError("plays or edges of two operators differ, expected one lattice")
    return alternatives


def _lattice(operator: PreisachPlays, reach_V: float) -> tuple[Array, Mask]:
    """Return the drive levels of the lattice, and which of them the state of each play can reach.

    returned  (levels,) V, and (plays, levels); the reach is rounded up to the lattice
    """
    first_V, step_V = operator.edge_V[0], operator.step_V
    slack = 1e-9
    low = np.floor((-reach_V - first_V) / step_V + slack)
    high = np.ceil((reach_V - first_V) / step_V - slack)
    index = np.arange(low, high + 1)
    inward = np.arange(len(operator.value_m))
    inward = np.minimum(inward, (len(index) - 1) // 2)[:, None]
    return first_V + step_V * index, (index >= low + inward) & (index <= high - inward)


def _values(operator: PreisachPlays, level_V: Array) -> Array:
    """Return the values of all functions at all levels, (plays, levels) m."""
    return np.array([straight_between(level_V, operator.edge_V, v) for v in operator.value_m])


def _half_range(value_m: Array, allowed: Mask) -> Array:
    """Return half the range of sums over admissible states, (sums,).

    value_m  (sums, plays, levels)
    """
    return 0.5 * (_maximum(value_m, allowed) + _maximum(-value_m, allowed))


def _maximum(value_m: Array, allowed: Mask) -> Array:
    """Return the maximum of each sum over the admissible states, by dynamic programming."""
    best_m = np.where(allowed[-1], value_m[:, -1], -np.inf)
    for play in range(value_m.shape[1] - 2, -1, -1):
        padded_m = np.pad(best_m, ((0, 0), (1, 1)), constant_values=-np.inf)
        best_m = np.maximum(np.maximum(padded_m[:, :-2], padded_m[:, 2:]), best_m)
        best_m = np.where(allowed[play], value_m[:, play] + best_m, -np.inf)
    return np.asarray(best_m.max(axis=1))


def _branch_slopes(value_m: Array, allowed: Mask) -> Array:
    """Return the rise per step of all branches, (2, plays, levels - 1); NaN where undefined.

    On a rising branch at level k play i has the state k - i, on a falling branch k + i. The sums
    are over the moving plays, beginning with the narrowest.
    """
    slopes = []
    for direction in (1, -1):  # a falling branch is a rising one on the reversed lattice
        rise_m = np.diff(value_m[:, ::direction], axis=1) * direction
        is_allowed = (allowed[:, 1:] & allowed[:, :-1])[:, ::direction]
        plays, steps = rise_m.shape
        summed = np.full((plays, steps), np.nan)
        sum_m = np.zeros(steps)
        for play in range(plays):
            shifted_m = np.full(steps, np.nan)
            shifted_m[play:] = np.where(is_allowed[play], rise_m[play], np.nan)[: steps - play]
            sum_m = sum_m + shifted_m
            summed[play] = sum_m
        slopes.append(summed)
    return np.array(slopes)
