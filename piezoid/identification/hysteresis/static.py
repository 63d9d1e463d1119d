"""The static output Psi(H[u]) and its tangents, before any filter.

y = Psi(h),  h = sum_i w_i z_i,  sigma = Psi'(h),  a_i = dz_i/dz_i(0)

dy/dw_i     = sigma z_i
dy/dd_j     = sigma sum_(i>=j) w_i (dz_i/dr_i + a_i s_j)
dy/ds_j     = sigma d_j sum_(i>=j) w_i a_i
dy/dslope_k = the part of h inside segment k
dy/dknot_k  = the change of slope there, where h is beyond it
dy/dg_k     = sigma (w_0 c_k(u) + sum_i w_i c_k(u where play i last moved)), c_k the part of
              the drive inside segment k of gamma
"""

import itertools
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.coordinates import Scaled
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.play import PlayTangents


@dataclass(frozen=True, kw_only=True, eq=False)
class Static:
    """The static part of one piece.

    operator  in scaled units
    slopes    (plays,)  memory slopes of the piece
    first     scaled drive at its first sample
    """

    operator: Scaled
    slopes: Array
    first: float

    def columns(self, u: Array, tangents: PlayTangents) -> Array:
        """Return [y | tangents] before any filter, in the order of the vector, then by memory.

        u         (rows,)         scaled drive
        tangents  (rows, plays)   of plays that followed gamma(u)
        """
        operator = self.operator
        plays, zones = len(operator.gap), len(operator.knot) - 1
        bends = len(operator.envelope.threshold) - 1
        weight, drive = operator.weight[1:], operator.envelope.run(u)
        edges = np.cumsum([1, plays, 1, plays, 2 * zones, bends, plays])
        columns = np.empty((len(u), edges[-1]), order="F")
        parts = [columns[:, a:b] for a, b in itertools.pairwise(edges)]
        by_gap, by_first_weight, by_weight, by_zones, by_envelope, by_memory = parts
        h = operator.weight[0] * drive + tangents.state @ weight
        columns[:, 0], sigma = from_slopes(operator.knot, operator.slope).run_with_slope(h)
        steep = sigma[:, None]
        np.multiply(tangents.memory, weight * steep, out=by_memory)
        _tail_sum(by_memory)
        np.multiply(tangents.threshold, weight * steep, out=by_gap)
        _tail_sum(by_gap)
        by_gap += by_memory * self.slopes
        by_memory *= operator.gap
        np.multiply(drive, sigma, out=by_first_weight[:, 0])
        np.multiply(tangents.state, steep, out=by_weight)
        _fill_zone_columns(h, operator, by_zones)
        if bends:
            self._fill_envelope(u, tangents, steep, by_envelope)
        return columns

    def _fill_envelope(
        self, u: Array, tangents: PlayTangents, steep: Array, columns: Array
    ) -> None:
        """Write d/d slopes of gamma: a play remembers the drive at which it last moved.

        z = gamma(u_last) + s r with s = dz/dr, so u_last = gamma^-1(z - s r); a play that never
        moved holds gamma(u(0)) and its memory slopes.
        """
        envelope, weight = self.operator.envelope, self.operator.weight
        moved = tangents.state - tangents.threshold * self.operator.threshold
        shape = moved.shape
        last = envelope.inverse().run(moved.ravel(order="F")).reshape(shape, order="F")
        last = np.where(tangents.memory > 0, self.first, last)
        zero = envelope.zero
        places, bends = envelope.threshold[zero + 1 :], zero
        width = np.diff(places, append=np.inf)
        for k in range(bends):
            for column, sign in ((k, -1.0), (bends + k, 1.0)):
                held = np.clip(sign * last - places[k], 0.0, width[k]) @ weight[1:]
                own = np.clip(sign * u - places[k], 0.0, width[k]) * weight[0]
                columns[:, column] = sign * (held + own)
        columns *= steep


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
