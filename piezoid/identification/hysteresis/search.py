"""Fit of one shape: lag, convex start and Gauss-Newton, with the error on held-out rows.

The start is Kuhnen's quadratic program for the weights, which is convex because it parametrises
the inverse of Psi. The lag is removed first: it would look like hysteresis and corrupt the
weights. A program with many plays on a fine grid locates the curvature of the loading curve. The
centres of clusters of its weights are the second set of thresholds, from which a search with few
plays avoids poor local minima.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.forward import Scaled
from piezoid.identification.hysteresis.coordinates import (
    MIN_GAP,
    MIN_SLOPE,
    Coordinates,
    Shape,
    shape_of,
    vector_of,
    with_flat_envelope,
)
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, Task, minimise
from piezoid.identification.hysteresis.pieces import Piece, widest_swing
from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search
from piezoid.numerics.quadratic_program import (
    Optimum,
    bounded_step,
    constrained_least_squares,
    empty_triangle,
    gather,
    stationarity,
)
from piezoid.operators.dead_zone import DeadZones, from_slopes
from piezoid.operators.filters import lagged
from piezoid.operators.play import play_blocks, play_columns

START_ROWS = 6000  # of a recording, which suffice for a start
MIN_INVERSE_SLOPE = 0.02  # of Psi'
GRID = 39  # plays of the fine grid
MANY_PLAYS = 6  # with more plays the better of two starts is enough
# Scaled: kinks of 0.1 cost 1e-11, a thousandth of the square of the lowest noise (1e-4).
RIDGE = 1e-9
THRESHOLDS = ("gap", "below_gap", "above_gap")
SHARED = tuple(Coordinates(shape=Shape(plays=0, below=0, above=0), offsets=()).slices)
MIN_DISTANCE = 0.01  # of half the drive's range: plays with closer thresholds are merged
MIN_WEIGHT = 1e-4  # of the total slope: smaller weights are dropped
MIN_KINK = 1e-3  # smaller changes of slope are dropped
MAX_RMS_RATIO = 1.002  # of a pruned fit to the original


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a fit.

    longest_lag_s   upper bound of the lag
    sensor_pole_Hz  declared pole behind the operator, or None
    rows            maximum number of rows; more are thinned
    follow_zero     whether knots follow slow motion of the zero
    iterations      maximum number of Jacobians
    lag_s           start of the lag; None: found by a search over the full range
    """

    longest_lag_s: float
    sensor_pole_Hz: float | None = None
    rows: int = 8000
    follow_zero: bool = True
    iterations: int = 30
    lag_s: float | None = None


def search(pieces: Sequence[Piece], shape: Shape, settings: Settings) -> HysteresisFit:
    """Fit one shape to pieces, starting from a convex problem."""
    lag_s = settings.lag_s
    if lag_s is None:
        lag_s = find_lag(pieces, shape.lag, settings.longest_lag_s)
    if shape.plays:
        clustered = clustered_thresholds(pieces, shape, lag_s)
        starts = [kuhnen_start(pieces, shape, lag_s, threshold) for threshold in (None, clustered)]
    else:
        starts = [(linear_start(pieces, lag_s), 0.0, 0.0)]
    # The cost jumps as kinks pass samples: all other parameters are fitted before the thresholds.
    fits = sorted(
        (
            _fit_with_fixed(
                pieces,
                with_flat_envelope(operator, shape.bends),
                shape.lag,
                settings,
                fixed=THRESHOLDS,
                offset=offset,
                kkt_gap=kkt_gap,
            )
            for operator, offset, kkt_gap in starts
        ),
        key=lambda fit: fit.rms,
    )
    # With few plays the better of two starts may lie farther from the minimum.
    candidates = fits if shape.plays <= MANY_PLAYS else fits[:1]
    return min(
        (
            minimise(fit.theta, fit.task, iterations=settings.iterations, kkt_gap=fit.kkt_gap)
            for fit in candidates
        ),
        key=lambda fit: fit.rms,
    )


def search_from(
    pieces: Sequence[Piece], operator: Scaled, lag: str, settings: Settings
) -> HysteresisFit:
    """Fit the shape of an operator from its values: zeros and memory first, then the rest."""
    start = _fit_with_fixed(pieces, operator, lag, settings, fixed=SHARED)
    return minimise(start.theta, start.task, iterations=settings.iterations)


def _fit_with_fixed(
    pieces: Sequence[Piece],
    operator: Scaled,
    lag: str,
    settings: Settings,
    *,
    fixed: tuple[str, ...],
    offset: float = 0.0,
    kkt_gap: float = 0.0,
) -> HysteresisFit:
    """Fit all parameters except some shared groups, in a third of the iterations.

    fixed   names of the groups that keep the values of the operator, thresholds among them
    offset  start of the zeros of the pieces, scaled displacement
    """
    task = task_for(pieces, operator, lag, settings)
    theta = vector_of(operator, task.coordinates)
    for index in range(len(pieces)):
        theta[task.coordinates.offset_slice(index)] = offset
    slices = tuple(task.coordinates.slices[name] for name in fixed)
    fixed_task = replace(task, fixed=slices, swing=None)
    fit = minimise(theta, fixed_task, iterations=settings.iterations // 3, kkt_gap=kkt_gap)
    return replace(fit, task=task)


def task_for(pieces: Sequence[Piece], operator: Scaled, lag: str, settings: Settings) -> Task:
    """Return the least-squares problem for the shape of an operator on some pieces."""
    offsets = [1] * len(pieces)
    if settings.follow_zero:  # one knot and one more for every four cycles: slower than any loop
        levels = [np.signbit(p.fitted_drive - np.median(p.fitted_drive)) for p in pieces]
        crossings = [int(np.count_nonzero(np.diff(is_low))) for is_low in levels]
        offsets = [1 + min(count // 8, 12) for count in crossings]
    stride = max(1, sum(piece.rows for piece in pieces) // settings.rows)
    return Task(
        pieces=tuple(pieces),
        coordinates=Coordinates(shape=shape_of(operator, lag), offsets=tuple(offsets)),
        sensor_pole_Hz=settings.sensor_pole_Hz,
        samples=[piece.fitted_samples(stride) for piece in pieces],
        longest_lag_s=settings.longest_lag_s,
        swing=widest_swing(pieces),
        ridge=RIDGE,
    )


def refit_initial_state(fit: HysteresisFit, pieces: Sequence[Piece]) -> HysteresisFit:
    """Fit zero and initial memory of other pieces, with the operator fixed."""
    settings = Settings(
        longest_lag_s=fit.task.longest_lag_s,
        sensor_pole_Hz=fit.task.sensor_pole_Hz,
        follow_zero=False,
        iterations=36,
    )
    return _fit_with_fixed(pieces, fit.operator, fit.shape.lag, settings, fixed=SHARED)


def prune(fit: HysteresisFit, *, iterations: int) -> HysteresisFit:
    """Remove superfluous plays and kinks from a fit, unless its error grows without them.

    Plays and kinks of negligible size are dropped, and plays of nearly equal threshold merged.
    """
    original, old = fit.operator, fit.task.coordinates
    threshold, weight = [0.0], [float(original.weight[0])]
    negligible = MIN_WEIGHT * float(original.weight.sum())
    for r, w in zip(original.threshold, original.weight[1:], strict=True):
        if w <= negligible:
            continue
        if r - threshold[-1] < MIN_DISTANCE and len(threshold) > 1:
            share = w / (w + weight[-1])
            threshold[-1] += share * (r - threshold[-1])
            weight[-1] += w
        else:
            threshold.append(float(r))
            weight.append(float(w))
    is_kink = np.abs(np.diff(original.slope)) > MIN_KINK
    is_kink[original.zero] = True
    kinks = np.flatnonzero(is_kink)
    if len(threshold) == len(original.weight) and len(kinks) == len(original.knot):
        return fit
    zero = int(np.searchsorted(kinks, original.zero))
    operator = replace(
        original,
        gap=np.diff(threshold),
        threshold=np.array(threshold[1:]),
        weight=np.array(weight),
        knot=original.knot[kinks],
        slope=np.concatenate(
            [original.slope[kinks[: zero + 1]], original.slope[kinks[zero:] + 1]]
        ),
        zero=zero,
    )

    coordinates = Coordinates(shape=shape_of(operator, fit.shape.lag), offsets=old.offsets)
    theta = vector_of(operator, coordinates)
    radius = np.concatenate([[0.0], original.threshold])
    for index in range(len(old.offsets)):
        theta[coordinates.offset_slice(index)] = fit.theta[old.offset_slice(index)]
        # Memory slopes that preserve the states of the remaining plays.
        slopes = fit.theta[old.memory_slice(index)]
        curve = np.concatenate([[0.0], np.cumsum(original.gap * slopes)])
        state = np.interp(operator.threshold, radius, curve)
        slopes = np.clip(np.diff(state, prepend=0.0) / operator.gap, -1.0, 1.0)
        theta[coordinates.memory_slice(index)] = slopes
    task = replace(fit.task, coordinates=coordinates)
    pruned = minimise(theta, task, iterations=iterations, kkt_gap=fit.kkt_gap)
    return fit if pruned.rms > MAX_RMS_RATIO * fit.rms else pruned


def kuhnen_start(
    pieces: Sequence[Piece], shape: Shape, lag_s: float, threshold: Array | None = None
) -> tuple[Scaled, float, float]:
    """Solve Kuhnen's quadratic program on the lag-corrected pieces.

    Returns the operator with central slope 1, the scaled displacement at which its output is 0,
    and the KKT gap of the program.

    threshold  (plays + 1,) scaled, from 0; None spreads them evenly over the widest swing

        E[k] = sum_i w_i z_i[k] - sum_j w'_j s_j(y[k]) + c_p,   min sum E^2
        w_0 >= eps, w_i >= 0, slopes of Psi' >= eps, (U - r)'w = U       [Kuhnen 2003]

    with an offset c_p for every piece; Psi is the inverse of the Psi' found.
    """
    if threshold is None:
        low, high = widest_swing(pieces)
        threshold = 0.5 * (high - low) * np.arange(shape.plays + 1) / (shape.plays + 1)
    # Thresholds of Psi': 0, and (j - 1/2) / l of each extreme displacement.
    highest = max(float(piece.response.max()) for piece in pieces)
    lowest = min(float(piece.response.min()) for piece in pieces)
    above = (np.arange(1, shape.above + 1) - 0.5) / max(shape.above, 1) * highest
    below = (np.arange(-shape.below, 0) + 0.5) / max(shape.below, 1) * -lowest
    zones = np.concatenate([below, [0.0], above])
    optimum = optimum_of(triangle_of(pieces, threshold, zones, lag_s), threshold, zones)
    weight = np.maximum(optimum.x[: shape.plays + 1], 0.0)
    inverse = DeadZones(
        threshold=zones, weight=optimum.x[shape.plays + 1 : shape.plays + 1 + len(zones)]
    )
    constant = float(np.mean(optimum.x[shape.plays + 1 + len(zones) :]))
    # Rewrite Psi(h + c) as offset + Psi_c(h) with Psi_c(0) = 0 and central slope 1.
    psi = inverse.inverse()
    kinks = psi.threshold[psi.threshold != 0.0] - constant
    slope = np.delete(psi.slope, psi.zero)
    zero = int(np.searchsorted(kinks, 0.0))
    knots_below = -_spread(-kinks[:zero][::-1], 0.01)[::-1]
    knot = np.concatenate([knots_below, [0.0], _spread(kinks[zero:], 0.01)])
    slope = np.concatenate([slope[: zero + 1], slope[zero:]])
    centre = slope[zero]
    operator = Scaled(
        gap=np.diff(threshold),
        threshold=threshold[1:],
        weight=weight * centre,
        knot=knot * centre,
        slope=slope / centre,
        zero=zero,
        lag_s=lag_s,
    )
    offset = float(psi.run(np.array([constant]))[0])
    return operator, offset, optimum.kkt_gap


def triangle_of(pieces: Sequence[Piece], threshold: Array, zones: Array, lag_s: float) -> Array:
    """Return the triangular factor of the rows [z | -s(y) | offsets], one offset per piece."""
    plays, count = len(threshold), len(zones)
    unit = DeadZones(threshold=zones, weight=np.ones(count))
    unknowns = plays + count + len(pieces)
    triangle = empty_triangle(unknowns)
    for index, piece in enumerate(pieces):
        sample = piece.fitted_samples(max(1, piece.rows // START_ROWS))
        rows = np.zeros((len(sample), unknowns), order="F")
        begin = 0
        for first, states in play_blocks(piece.drive, threshold, np.full(plays, piece.drive[0])):
            end = int(np.searchsorted(sample, first + len(states)))
            rows[begin:end, :plays] = states[sample[begin:end] - first]
            begin = end
        without_lag = sample + lag_s * piece.sampling_rate_Hz
        measured = np.interp(without_lag, np.arange(len(piece.response)), piece.response)
        rows[:, plays : plays + count] = -unit.columns(measured)
        rows[:, plays + count + index] = 1.0
        triangle = gather(triangle, rows, spend=True)
    return triangle


def optimum_of(triangle: Array, threshold: Array, zones: Array) -> Optimum:
    """Solve the program, given the triangular factor of its rows with the offsets last.

    The unknowns are first slopes of Psi' instead of weights, so that their limits are bounds; w_0
    follows from the normalisation: w_0 = 1 - sum_(i>0) (1 - r_i) w_i in scaled units, r_0 = 0. The
    general program is solved only if w_0 is then below its own limit.
    """
    plays, count = len(threshold), len(zones)
    zero = int(np.flatnonzero(zones == 0.0)[0])
    free = np.eye(len(triangle.T))
    free[0, :plays] = threshold - 1.0
    for zone in range(count):
        if zone != zero:
            free[plays + zone, plays + zone + (1 if zone < zero else -1)] = -1.0
    lower = np.full(len(free) - 1, -np.inf)
    lower[: plays - 1], lower[plays - 1 : plays - 1 + count] = 0.0, MIN_INVERSE_SLOPE
    step = bounded_step(
        triangle @ free[:, 1:], -triangle[:, 0], lower, np.full(len(lower), np.inf)
    )
    x = free[:, 1:] @ step
    x[0] += 1.0

    constraint, low, high = constraints_of(threshold, zones, triangle.shape[1])
    target = np.zeros(len(triangle))
    if x[0] < MIN_SLOPE:
        return constrained_least_squares(triangle, target, constraint, low, high)
    return Optimum(
        x=x,
        cost=float(np.sum((triangle @ x) ** 2)),
        kkt_gap=stationarity(triangle, x, target, constraint, (low, high)),
    )


def constraints_of(threshold: Array, zones: Array, unknowns: int) -> tuple[Array, Array, Array]:
    """Return A, l and u of l <= A x <= u: weights, slopes of Psi', and a normalisation."""
    plays, count = len(threshold), len(zones)
    zero = int(np.flatnonzero(zones == 0.0)[0])
    rows = np.zeros((plays + count + 1, unknowns))
    rows[:plays, :plays] = np.eye(plays)
    for i in range(count):
        rows[plays + i, plays + min(i, zero) : plays + max(i, zero) + 1] = 1.0
    rows[-1, :plays] = 1.0 - threshold
    lower = np.concatenate([np.zeros(plays), np.full(count, MIN_INVERSE_SLOPE), [1.0]])
    lower[0] = MIN_SLOPE
    upper = np.full(len(rows), np.inf)
    upper[-1] = 1.0
    return rows, lower, upper


def _spread(positions: Array, distance: float) -> Array:
    """Return increasing positions at a minimum distance from the origin and from each other."""
    ladder = distance * np.arange(1, len(positions) + 1)
    return np.asarray(np.maximum.accumulate(np.maximum(positions - ladder, 0.0)) + ladder)


def linear_start(pieces: Sequence[Piece], lag_s: float) -> Scaled:
    """Return a model without plays or dead zones: one gain."""
    drive = np.concatenate([p.drive - p.drive.mean() for p in pieces])
    response = np.concatenate([p.response - p.response.mean() for p in pieces])
    gain = max(float(drive @ response / (drive @ drive)), MIN_SLOPE)
    empty = np.zeros(0)
    psi = from_slopes(np.zeros(1), np.ones(2))
    return Scaled(
        gap=empty,
        threshold=empty,
        weight=np.array([gain]),
        knot=psi.threshold,
        slope=psi.slope,
        zero=0,
        lag_s=lag_s,
    )


def clustered_thresholds(pieces: Sequence[Piece], shape: Shape, lag_s: float) -> Array:
    """Return 0 and thresholds at the centres of clusters of the weights on a fine grid.

        min sum_g sum_(i in g) w_i (r_i - c_g)^2

    The optimal partition into groups of neighbours is exact, by dynamic programming over cuts.
    """
    fine = Shape(plays=GRID, below=shape.below, above=shape.above, lag=shape.lag)
    operator, _, _ = kuhnen_start(pieces, fine, lag_s)
    position, weight, groups = operator.threshold, operator.weight[1:], shape.plays
    tiny = weight + 1e-6 * (weight.sum() + 1e-300) / len(weight)
    sums = [np.concatenate([[0.0], np.cumsum(tiny * position**k)]) for k in range(3)]
    count = len(position)
    mass, first, second = (s - s[:, None] for s in sums)
    group = np.triu(np.ones((count + 1, count + 1), dtype=bool), 1)
    cost = np.full((count + 1, count + 1), np.inf)
    cost[group] = second[group] - first[group] ** 2 / mass[group]
    best = np.full((groups + 1, count + 1), np.inf)
    cut = np.zeros((groups + 1, count + 1), dtype=int)
    best[0, 0] = 0.0
    for g in range(1, groups + 1):
        options = best[g - 1, :, None] + cost
        cut[g] = options.argmin(axis=0)
        best[g] = options.min(axis=0)
    centres, end = np.empty(groups), count
    for g in range(groups, 0, -1):
        start = cut[g, end]
        centres[g - 1] = (sums[1][end] - sums[1][start]) / (sums[0][end] - sums[0][start])
        end = start
    return np.concatenate([[0.0], _spread(centres, 2 * MIN_GAP)])


def find_lag(pieces: Sequence[Piece], kind: str, longest_s: float) -> float:
    """Return the lag with the least error of an additive model, by global search.

    The model is a non-negative sum of plays of the drive, a cubic of the drive and an offset per
    piece; for a given lag it is linear. The error is not convex in the lag, hence the
    derivative-free global search.

    kind       ``none``, ``delay`` or ``first_order``
    longest_s  upper bound of the lag
    """
    if kind == "none" or longest_s <= 0.0:
        return 0.0
    threshold = np.linspace(0.0, 0.9, 10)
    lower = np.append(np.zeros(len(threshold)), np.full(3, -np.inf))
    columns = []
    for piece in pieces:
        u = piece.drive
        states, _ = play_columns(u, threshold, np.full(len(threshold), u[0]))
        columns.append(np.asfortranarray(np.column_stack([states, u**2, u**3])))

    def error(x: Array) -> float:
        total = 0.0
        for piece, column in zip(pieces, columns, strict=True):
            stride = max(1, piece.rows // START_ROWS)
            keep, sample = slice(piece.first, piece.last, stride), piece.fitted_samples(stride)
            lag_s = float(x[0]) * longest_s
            rows = lagged(column, kind, lag_s, piece.sampling_rate_Hz, keep=keep)
            rows = rows[(sample - piece.first) // stride]
            block = np.column_stack([rows, np.ones(len(rows)), piece.response[sample]])
            triangle = gather(empty_triangle(block.shape[1]), block, spend=True)
            design, target = triangle[:, :-1], triangle[:, -1]
            weights = bounded_step(design, target, lower, np.full(len(lower), np.inf))
            total += float(np.sum((design @ weights - target) ** 2)) / len(rows)
        return total

    share, _ = direct_search(
        error,
        np.array([0.02]),
        (np.zeros(1), np.ones(1)),
        initial_step=0.02,
        max_evaluations=25,
        step_tolerance=1e-5,
        global_evaluations=25,
    )
    return float(share[0]) * longest_s
