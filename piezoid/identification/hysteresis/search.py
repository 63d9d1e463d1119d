"""Fit of one shape: lag, convex start and Gauss-Newton, with the error on held-out rows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.forward import Scaled
from piezoid.identification.hysteresis.convex_start import (
    clustered_thresholds,
    find_lag,
    kuhnen_start,
    linear_start,
)
from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Shape,
    shape_of,
    vector_of,
    with_flat_envelope,
)
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, Task, minimise
from piezoid.identification.hysteresis.pieces import Piece, widest_swing

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
        starts = [linear_start(pieces, lag_s)]
    # The cost jumps as kinks pass samples: all other parameters are fitted before the thresholds.
    fits = sorted(
        (
            _fit_with_fixed(
                pieces,
                with_flat_envelope(start.operator, shape.bends),
                shape.lag,
                settings,
                fixed=THRESHOLDS,
                offset=start.offset,
                kkt_gap=start.kkt_gap,
            )
            for start in starts
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
