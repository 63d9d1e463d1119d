"""How far two sums of plays behind functions can be apart, exactly, over all histories.

With plays and edges on one lattice a drive leaves both in the same states:

    y_t - y_m = sum_i g_i(z_i),   g_i = phi_i of one - phi_i of the other
    |z_i - z_(i-1)| <= r_1,   |z_i| <= max(R - r_i, 0)

for every drive within R that began de-poled or at an end of it. The g_i bend on the lattice alone
and all constraints are differences of whole steps, so that the extremes lie on it: states with the
same fraction of a step can move together, and the sum changes straight until they meet others.
Dynamic programming from the widest play to the narrowest finds them.

Along a branch on which the plays up to some j move, both have slopes, and the slope of one behind
the inverse of the other is their ratio. There are as many ratios as j and places on the lattice.
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
    places_V, allowed = _lattice(operator, reach_V)
    value_m = _values(operator, places_V)
    value_m[0] -= slope_m_per_V * places_V
    return float(_half_range(value_m[None], allowed)[0])


def farthest_apart_m(
    model: PreisachPlays, others: Sequence[PreisachPlays], reach_V: float
) -> Array:
    """Return sup |y_other - y_model - c| over drives within a reach, for the best c, (others,).

    All on one lattice, or ``ValueError`` is raised.

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> farthest_apart_m(straight, [straight], 2.0)
    array([0.])
    """
    places_V, allowed = _lattice(model, reach_V)
    own_m = _values(model, places_V)
    apart_m = np.array([_values(other, places_V) - own_m for other in _alike(model, others)])
    return _half_range(apart_m, allowed)


def slope_ratios(model: PreisachPlays, others: Sequence[PreisachPlays], reach_V: float) -> Array:
    """Return least and greatest increment gain of the others behind the model's inverse.

    returned  (others, 2)

    >>> straight = PreisachPlays(
    ...     step_V=1.0,
    ...     edge_V=np.array([-2.0, 2.0]),
    ...     value_m=np.array([[-2.0, 2.0], [-1.0, 1.0]]),
    ... )
    >>> slope_ratios(straight, [straight], 2.0)
    array([[1., 1.]])
    """
    places_V, allowed = _lattice(model, reach_V)
    own = _branch_slopes(_values(model, places_V), allowed)
    found = []
    for other in _alike(model, others):
        ratio = _branch_slopes(_values(other, places_V), allowed) / own
        found.append((np.nanmin(ratio), np.nanmax(ratio)))
    return np.array(found)


def _alike(model: PreisachPlays, others: Sequence[PreisachPlays]) -> Sequence[PreisachPlays]:
    for other in others:
        if (
            other.value_m.shape != model.value_m.shape
            or other.step_V != model.step_V
            or not np.array_equal(other.edge_V, model.edge_V)
        ):
            raise ValueError("plays or edges of two operators differ, expected one lattice")
    return others


def _lattice(operator: PreisachPlays, reach_V: float) -> tuple[Array, Mask]:
    """Return the places that the drive may have, and which of them each play may stand at.

    returned  (places,) V, and (plays, places); the reach is rounded up to the lattice
    """
    first_V, step_V = operator.edge_V[0], operator.step_V
    slack = 1e-9
    low = np.floor((-reach_V - first_V) / step_V + slack)
    high = np.ceil((reach_V - first_V) / step_V - slack)
    place = np.arange(low, high + 1)
    inward = np.arange(len(operator.value_m))
    inward = np.minimum(inward, (len(place) - 1) // 2)[:, None]
    return first_V + step_V * place, (place >= low + inward) & (place <= high - inward)


def _values(operator: PreisachPlays, places_V: Array) -> Array:
    """Return every function at every place, (plays, places) m."""
    return np.array([straight_between(places_V, operator.edge_V, v) for v in operator.value_m])


def _half_range(value_m: Array, allowed: Mask) -> Array:
    """Return half of what lies between the extremes of sums over nested states, (sums,).

    value_m  (sums, plays, places)
    """
    return 0.5 * (_greatest(value_m, allowed) + _greatest(-value_m, allowed))


def _greatest(value_m: Array, allowed: Mask) -> Array:
    best_m = np.where(allowed[-1], value_m[:, -1], -np.inf)
    for play in range(value_m.shape[1] - 2, -1, -1):
        beside_m = np.pad(best_m, ((0, 0), (1, 1)), constant_values=-np.inf)
        best_m = np.maximum(np.maximum(beside_m[:, :-2], beside_m[:, 2:]), best_m)
        best_m = np.where(allowed[play], value_m[:, play] + best_m, -np.inf)
    return np.asarray(best_m.max(axis=1))


def _branch_slopes(value_m: Array, allowed: Mask) -> Array:
    """Return the rise a step of all branches, (2, plays, places - 1); NaN where there is none.

    Up a branch at place k the play i stands at k - i, down it at k + i: the sum over those that
    move, from the narrowest on.
    """
    found = []
    for way in (1, -1):  # down is up, seen from the other end
        rise_m = np.diff(value_m[:, ::way], axis=1) * way
        free = (allowed[:, 1:] & allowed[:, :-1])[:, ::way]
        plays, places = rise_m.shape
        summed = np.full((plays, places), np.nan)
        sum_m = np.zeros(places)
        for play in range(plays):
            shifted_m = np.full(places, np.nan)
            shifted_m[play:] = np.where(free[play], rise_m[play], np.nan)[: places - play]
            sum_m = sum_m + shifted_m
            summed[play] = sum_m
        found.append(summed)
    return np.array(found)
