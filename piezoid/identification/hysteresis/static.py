"""The static output Psi(H[u]) and its tangents, before any filter.

y = Psi(h),  h = sum_i w_i z_i,  sigma = Psi'(h),  a_i = dz_i/dz_i(0)

dy/dw_i     = sigma z_i
dy/dd_j     = sigma sum_(i>=j) w_i (dz_i/dr_i + a_i s_j)
dy/ds_j     = sigma d_j sum_(i>=j) w_i a_i
dy/dslope_k = the part of h inside segment k
dy/dknot_k  = the change of slope there, where h is beyond it
"""

import numpy as np

from piezoid.identification.hysteresis.coordinates import Scaled
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.play import PlayTangents


def static_columns(u: Array, tangents: PlayTangents, operator: Scaled, slopes: Array) -> Array:
    """Return [y | tangents] before any filter, in the order of the vector, then by memory."""
    plays, zones = len(operator.gap), len(operator.knot) - 1
    weight = operator.weight[1:]
    columns = np.empty((len(u), 2 + 3 * plays + 2 * zones), order="F")
    h = operator.weight[0] * u + tangents.state @ weight
    columns[:, 0], sigma = from_slopes(operator.knot, operator.slope).run_with_slope(h)
    steep = sigma[:, None]
    by_memory = columns[:, 2 + 2 * plays + 2 * zones :]
    np.multiply(tangents.memory, weight * steep, out=by_memory)
    _tail_sum(by_memory)
    by_gap = columns[:, 1 : 1 + plays]
    np.multiply(tangents.threshold, weight * steep, out=by_gap)
    _tail_sum(by_gap)
    by_gap += by_memory * slopes
    by_memory *= operator.gap
    columns[:, 1 + plays] = sigma * u
    np.multiply(tangents.state, steep, out=columns[:, 2 + plays : 2 + 2 * plays])
    _fill_zone_columns(h, operator, columns[:, 2 + 2 * plays : 2 + 2 * plays + 2 * zones])
    return columns


def _tail_sum(columns: Array) -> None:
    """Replace every column by the sum of itself and all columns behind it."""
    for j in range(columns.shape[1] - 2, -1, -1):
        columns[:, j] += columns[:, j + 1]


def _fill_zone_columns(h: Array, operator: Scaled, columns: Array) -> None:
    """Write d/d gaps and d/d slopes of the kinks below 0 and then of those above it."""
    zero = operator.zero
    below, above = columns[:, : 2 * zero], columns[:, 2 * zero :]
    knot, slope = -operator.knot[:zero][::-1], operator.slope[: zero + 1][::-1]
    _fill_side(-h, knot, slope, below)
    np.negative(below, out=below)
    _fill_side(h, operator.knot[zero + 1 :], operator.slope[zero + 1 :], above)


def _fill_side(h: Array, knot: Array, slope: Array, columns: Array) -> None:
    """Write the tangents of one side, seen with h growing outwards: gaps, then slopes."""
    count = len(knot)
    width = np.diff(knot, append=np.inf)
    for k in range(count):
        beyond = h - knot[k]
        columns[:, k] = (beyond > 0) * (slope[k] - slope[k + 1])
        columns[:, count + k] = np.clip(beyond, 0.0, width[k])
    _tail_sum(columns[:, :count])
