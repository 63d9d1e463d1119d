"""Where the search begins: Kuhnen's quadratic program.

The program parametrises the inverse of Psi, so that it is convex; the lag is removed first
(lag_search.py), because a lag that is not removed looks like hysteresis and corrupts the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.coordinates import LEAST_SLOPE, Scaled, Shape
from piezoid.identification.hysteresis.pieces import Piece, widest_swing
from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import (
    Optimum,
    bounded_step,
    constrained_least_squares,
    stationarity,
)
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.chain import Samples
from piezoid.operators.dead_zone import DeadZones, from_slopes
from piezoid.operators.play import play_blocks

ROWS = 6000  # rows of a recording that suffice for a start
LEAST_INVERSE_SLOPE = 0.02  # of Psi'


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """A convex start.

    operator  scaled operator, central slope 1
    offset    scaled displacement at which the operator's output is 0
    kkt_gap   of the quadratic program
    """

    operator: Scaled
    offset: float
    kkt_gap: float


def kuhnen_start(
    pieces: Sequence[Piece], shape: Shape, lag_s: float, threshold: Array | None = None
) -> Start:
    """Solve Kuhnen's quadratic program on the lag-corrected pieces.

    threshold  (plays + 1,) scaled, from 0; None spreads them evenly over the widest swing

        E[k] = sum_i w_i z_i[k] - sum_j w'_j s_j(y[k]) + c_p,   min sum E^2
        w_0 >= eps, w_i >= 0, slopes of Psi' >= eps, (U - r)'w = U       [Kuhnen 2003]

    with an offset c_p for every piece; Psi is the inverse of the Psi' found.
    """
    if threshold is None:
        low, high = widest_swing(pieces)
        threshold = 0.5 * (high - low) * np.arange(shape.plays + 1) / (shape.plays + 1)
    highest = max(float(piece.response.max()) for piece in pieces)
    lowest = min(float(piece.response.min()) for piece in pieces)
    zones = placed_zones(lowest, highest, shape)
    optimum = optimum_of(triangle_of(pieces, threshold, zones, lag_s), threshold, zones)
    weight = np.maximum(optimum.x[: shape.plays + 1], 0.0)
    inverse = DeadZones(
        threshold=zones, weight=optimum.x[shape.plays + 1 : shape.plays + 1 + len(zones)]
    )
    constant = float(np.mean(optimum.x[shape.plays + 1 + len(zones) :]))
    operator, offset = recentred(threshold, weight, inverse.inverse(), constant, lag_s)
    return Start(operator=operator, offset=offset, kkt_gap=optimum.kkt_gap)


def placed_zones(low: float, high: float, shape: Shape) -> Array:
    """Place the thresholds of Psi' at (j -+ 1/2) / l of the extreme displacement."""
    above = (np.arange(1, shape.above + 1) - 0.5) / max(shape.above, 1) * high
    below = (np.arange(-shape.below, 0) + 0.5) / max(shape.below, 1) * -low
    return np.concatenate([below, [0.0], above])


def triangle_of(pieces: Sequence[Piece], threshold: Array, zones: Array, lag_s: float) -> Array:
    """Return the triangle of the rows [z | -s(y) | offsets], one offset for each piece."""
    plays, count = len(threshold), len(zones)
    unit = DeadZones(threshold=zones, weight=np.ones(count))
    unknowns = plays + count + len(pieces)
    triangle = empty_triangle(unknowns)
    for index, piece in enumerate(pieces):
        sample = piece.counting(max(1, piece.rows // ROWS))
        rows = np.zeros((len(sample), unknowns), order="F")
        _put_states(rows[:, :plays], sample, piece.drive, threshold)
        rows[:, plays : plays + count] = -unit.columns(_advanced(piece, lag_s, sample))
        rows[:, plays + count + index] = 1.0
        triangle = gather(triangle, rows, spend=True)
    return triangle


def _put_states(rows: Array, sample: Samples, drive: Array, threshold: Array) -> None:
    """Write the states of a bank at these samples; those between are followed and forgotten."""
    done = 0
    for first, states in play_blocks(drive, threshold, np.full(len(threshold), drive[0])):
        end = int(np.searchsorted(sample, first + len(states)))
        rows[done:end] = states[sample[done:end] - first]
        done = end


def optimum_of(triangle: Array, threshold: Array, zones: Array) -> Optimum:
    """Solve the program on the triangle of its rows, the offsets' columns last."""
    limits = constraints_of(threshold, zones, triangle.shape[1])
    nothing = np.zeros(len(triangle))
    x = within_bounds(triangle, threshold, zones)
    if x[0] < LEAST_SLOPE:
        return constrained_least_squares(triangle, nothing, *limits)
    constraint, lower, upper = limits
    return Optimum(
        x=x,
        cost=float(np.sum((triangle @ x) ** 2)),
        kkt_gap=stationarity(triangle, x, nothing, constraint, (lower, upper)),
    )


def within_bounds(triangle: Array, threshold: Array, zones: Array) -> Array:
    """Return the optimum without the limit of w_0, by a search that knows only bounds.

    Slopes instead of weights of Psi' make their limits bounds, and w_0 follows from the others:
    w_0 = 1 - sum_(i>0) (1 - r_i) w_i in scaled units, r_0 = 0.
    """
    plays, count = len(threshold), len(zones)
    zero = int(np.flatnonzero(zones == 0.0)[0])
    free = np.eye(len(triangle.T))
    free[0, :plays] = threshold - 1.0
    for place in range(count):
        if place != zero:
            free[plays + place, plays + place + (1 if place < zero else -1)] = -1.0
    lower = np.full(len(free) - 1, -np.inf)
    lower[: plays - 1], lower[plays - 1 : plays - 1 + count] = 0.0, LEAST_INVERSE_SLOPE
    step = bounded_step(
        triangle @ free[:, 1:], -triangle[:, 0], lower, np.full(len(lower), np.inf)
    )
    x = free[:, 1:] @ step
    x[0] += 1.0
    return np.asarray(x)


def _advanced(piece: Piece, lag_s: float, sample: Samples) -> Array:
    """Return y(t + lag) at these samples: the measurement as it were without the lag."""
    index = sample + lag_s * piece.sampling_rate_Hz
    return np.asarray(np.interp(index, np.arange(len(piece.response)), piece.response))


def constraints_of(threshold: Array, zones: Array, unknowns: int) -> tuple[Array, Array, Array]:
    """Return A, l and u of the program: weights, then slopes of Psi', then what excludes 0."""
    plays, count = len(threshold), len(zones)
    zero = int(np.flatnonzero(zones == 0.0)[0])
    rows = np.zeros((plays + count + 1, unknowns))
    rows[:plays, :plays] = np.eye(plays)
    for i in range(count):
        rows[plays + i, plays + min(i, zero) : plays + max(i, zero) + 1] = 1.0
    rows[-1, :plays] = 1.0 - threshold
    lower = np.concatenate([np.zeros(plays), np.full(count, LEAST_INVERSE_SLOPE), [1.0]])
    lower[0] = LEAST_SLOPE
    upper = np.full(len(rows), np.inf)
    upper[-1] = 1.0
    return rows, lower, upper


def recentred(
    threshold: Array, weight: Array, psi: DeadZones, constant: float, lag_s: float
) -> tuple[Scaled, float]:
    """Rewrite Psi(h + c) as offset + Psi_c(h) with Psi_c(0) = 0 and central slope 1."""
    real = psi.threshold[psi.threshold != 0.0] - constant
    slope = np.delete(psi.slope, psi.zero)
    inside = int(np.searchsorted(real, 0.0))
    real[:inside] = -_spread(-real[:inside][::-1])[::-1]
    real[inside:] = _spread(real[inside:])
    knot = np.concatenate([real[:inside], [0.0], real[inside:]])
    slope = np.concatenate([slope[: inside + 1], slope[inside:]])
    centre = slope[inside]
    operator = Scaled(
        gap=np.diff(threshold),
        threshold=threshold[1:],
        weight=weight * centre,
        knot=knot * centre,
        slope=slope / centre,
        zero=inside,
        lag_s=lag_s,
    )
    offset = float(psi.run(np.array([constant]))[0])
    return operator, offset


def _spread(outward: Array) -> Array:
    """Return kinks at least a hundredth apart from the origin and from each other."""
    ladder = 0.01 * np.arange(1, len(outward) + 1)
    return np.asarray(np.maximum.accumulate(np.maximum(outward - ladder, 0.0)) + ladder)


def linear_start(pieces: Sequence[Piece], lag_s: float) -> Start:
    """Return the start of a model without plays or dead zones: one gain."""
    drive = np.concatenate([p.drive - p.drive.mean() for p in pieces])
    response = np.concatenate([p.response - p.response.mean() for p in pieces])
    gain = max(float(drive @ response / (drive @ drive)), LEAST_SLOPE)
    empty = np.zeros(0)
    psi = from_slopes(np.zeros(1), np.ones(2))
    operator = Scaled(
        gap=empty,
        threshold=empty,
        weight=np.array([gain]),
        knot=psi.threshold,
        slope=psi.slope,
        zero=0,
        lag_s=lag_s,
    )
    return Start(operator=operator, offset=0.0, kkt_gap=0.0)
