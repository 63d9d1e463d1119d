"""Fit of one shape: lag, convex start and Gauss-Newton, with the error on held-out rows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Scaled,
    Shape,
    bent,
    operator_of,
    vector_of,
)
from piezoid.identification.hysteresis.gauss_newton import Minimum, Task, minimise
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.rows import simulate
from piezoid.identification.hysteresis.start import (
    Start,
    find_lag,
    gathered_thresholds,
    kuhnen_start,
    linear_start,
)
from piezoid.numerics.arrays import Array

FEW = 6  # plays: with more, the better of two starts is enough
# Scaled: kinks of 0.1 cost 1e-11, a thousandth of the square of the finest noise (1e-4).
WEAK = 1e-9
THRESHOLDS = ("gap", "below_gap", "above_gap")
CLOSE_GAP = 0.01  # of half the drive's range: thresholds nearer than that are one
NO_WEIGHT = 1e-4  # of the total slope
NO_KINK = 1e-3  # negligible change of slope
NO_WORSE = 1.002  # rms of a fit with fewer parts that is kept


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """One fitted shape.

    task     the data and what the vector means
    minimum  where Gauss-Newton ended
    kkt_gap  of the quadratic program it started from
    """

    task: Task
    minimum: Minimum
    kkt_gap: float

    @property
    def operator(self) -> Scaled:
        """The fitted operator in scaled units."""
        return operator_of(self.minimum.theta, self.task.coordinates)

    @property
    def shape(self) -> Shape:
        """How many of what the fit really has."""
        return self.task.coordinates.shape


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a fit is made.

    longest_lag_s   upper bound of the lag, s
    sensor_pole_Hz  declared pole behind the operator, or None
    rows            how many rows a search may use; more are thinned
    follow_zero     whether slow motion of the zero is followed by knots
    iterations      most Jacobians of a search
    lag_s           where the lag begins; None searches for it over the whole range
    ridge           on the squares of all kinks
    """

    longest_lag_s: float
    sensor_pole_Hz: float | None = None
    rows: int = 8000
    follow_zero: bool = True
    iterations: int = 30
    lag_s: float | None = None
    ridge: float = WEAK


def search(pieces: Sequence[Piece], shape: Shape, settings: Settings) -> Fitted:
    """Fit one shape to pieces, from a convex start."""
    lag_s = settings.lag_s
    if lag_s is None:
        lag_s = find_lag(pieces, shape.lag, settings.longest_lag_s)
    if shape.plays:
        gathered = gathered_thresholds(pieces, shape, lag_s)
        starts = [kuhnen_start(pieces, shape, lag_s, threshold) for threshold in (None, gathered)]
    else:
        starts = [linear_start(pieces, lag_s)]
    # Kinks move the cost in jumps: weights first, thresholds once the rest is in place.
    first_rounds = replace(settings, iterations=settings.iterations // 3)
    settled = sorted(
        (_settled(pieces, shape, start, first_rounds) for start in starts),
        key=lambda fitted: fitted.minimum.rms,
    )
    # Few plays have few good places, and the better start may lie beside them: search from both.
    candidates = settled if shape.plays <= FEW else settled[:1]
    return min(
        (_searched(fitted, settings) for fitted in candidates),
        key=lambda fitted: fitted.minimum.rms,
    )


def searched_from(
    pieces: Sequence[Piece], operator: Scaled, lag: str, settings: Settings
) -> Fitted:
    """Fit the shape of an operator from there: zeros and memory first, then all of it."""
    task = task_for(pieces, operator, lag, settings)
    minimum = minimise(
        vector_of(operator, task.coordinates),
        replace(task, fixed=tuple(task.coordinates.slices)),
        iterations=settings.iterations // 3,
    )
    return _searched(Fitted(task=task, minimum=minimum, kkt_gap=0.0), settings)


def _searched(start: Fitted, settings: Settings) -> Fitted:
    minimum = minimise(start.minimum.theta, start.task, iterations=settings.iterations)
    return replace(start, minimum=minimum)


def _settled(pieces: Sequence[Piece], shape: Shape, start: Start, settings: Settings) -> Fitted:
    """Optimise everything but the thresholds."""
    operator = bent(start.operator, shape.bends)
    task = task_for(pieces, operator, shape.lag, settings)
    theta = vector_of(operator, task.coordinates)
    for index in range(len(pieces)):
        theta[task.coordinates.offset_slice(index)] = start.offset
    settled = minimise(theta, replace(task, fixed=THRESHOLDS), iterations=settings.iterations)
    return Fitted(task=task, minimum=settled, kkt_gap=start.kkt_gap)


def task_for(pieces: Sequence[Piece], operator: Scaled, lag: str, settings: Settings) -> Task:
    """Return the task whose vector can hold this operator on these pieces."""
    shape = Shape(
        plays=len(operator.gap),
        below=operator.zero,
        above=len(operator.knot) - operator.zero - 1,
        lag=lag,
        bends=operator.envelope.zero,
    )
    offsets = tuple(_zero_knots(piece) if settings.follow_zero else 1 for piece in pieces)
    return Task(
        pieces=tuple(pieces),
        coordinates=Coordinates(shape=shape, offsets=offsets),
        sensor_pole_Hz=settings.sensor_pole_Hz,
        stride=max(1, sum(piece.rows for piece in pieces) // settings.rows),
        longest_lag_s=settings.longest_lag_s,
        ridge=settings.ridge,
    )


def _zero_knots(piece: Piece) -> int:
    """Return one knot, and one more for every four cycles: slower than any loop."""
    u = piece.drive[piece.first : piece.last]
    crossings = int(np.count_nonzero(np.diff(np.signbit(u - np.median(u)))))
    return 1 + min(crossings // 8, 12)


def continued(fitted: Fitted, index: int, piece: Piece) -> Array:
    """Simulate a longer piece with the fitted parameters and zero."""
    return simulate(
        fitted.minimum.theta,
        fitted.task.coordinates,
        index,
        piece,
        fitted.task.sensor_pole_Hz,
    )


def transferred(fitted: Fitted, pieces: Sequence[Piece]) -> Fitted:
    """Fit only the zero and the initial memory of other pieces, with the operator fixed."""
    operator = fitted.operator
    settings = Settings(
        longest_lag_s=fitted.task.longest_lag_s,
        sensor_pole_Hz=fitted.task.sensor_pole_Hz,
        follow_zero=False,
    )
    task = task_for(pieces, operator, fitted.shape.lag, settings)
    task = replace(task, fixed=tuple(task.coordinates.slices))
    theta = vector_of(operator, task.coordinates)
    minimum = minimise(theta, task, iterations=12)
    return Fitted(task=task, minimum=minimum, kkt_gap=fitted.kkt_gap)


def simplified(fitted: Fitted, *, iterations: int) -> Fitted:
    """Return the fit without its superfluous plays and kinks, if it is as good without them."""
    operator = _without_small_kinks(_without_small_plays(fitted.operator))
    if len(operator.gap) == len(fitted.operator.gap) and len(operator.knot) == len(
        fitted.operator.knot
    ):
        return fitted
    shape = replace(
        fitted.shape,
        plays=len(operator.gap),
        below=operator.zero,
        above=len(operator.knot) - operator.zero - 1,
    )
    old = fitted.task.coordinates
    task = replace(fitted.task, coordinates=Coordinates(shape=shape, offsets=old.offsets))
    theta = vector_of(operator, task.coordinates)
    for index in range(len(old.offsets)):
        theta[task.coordinates.offset_slice(index)] = fitted.minimum.theta[old.offset_slice(index)]
        theta[task.coordinates.memory_slice(index)] = _memory(fitted, operator, index)
    minimum = minimise(theta, task, iterations=iterations)
    if minimum.rms > NO_WORSE * fitted.minimum.rms:
        return fitted
    return replace(fitted, task=task, minimum=minimum)


def _memory(fitted: Fitted, operator: Scaled, index: int) -> Array:
    """Return memory slopes for the remaining plays that give them the states they had."""
    old = fitted.operator
    slopes = fitted.minimum.theta[fitted.task.coordinates.memory_slice(index)]
    curve = np.concatenate([[0.0], np.cumsum(old.gap * slopes)])
    radius = np.concatenate([[0.0], old.threshold])
    state = np.interp(operator.threshold, radius, curve)
    return np.asarray(np.clip(np.diff(state, prepend=0.0) / operator.gap, -1.0, 1.0))


def _without_small_plays(operator: Scaled) -> Scaled:
    threshold = [0.0]
    weight = [float(operator.weight[0])]
    negligible = NO_WEIGHT * float(operator.weight.sum())
    for r, w in zip(operator.threshold, operator.weight[1:], strict=True):
        if w <= negligible:
            continue
        if r - threshold[-1] < CLOSE_GAP and len(threshold) > 1:
            share = w / (w + weight[-1])
            threshold[-1] += share * (r - threshold[-1])
            weight[-1] += w
        else:
            threshold.append(float(r))
            weight.append(float(w))
    moving = np.array(threshold[1:])
    gap = np.diff(moving, prepend=0.0)
    return replace(operator, gap=gap, threshold=moving, weight=np.array(weight))


def _without_small_kinks(operator: Scaled) -> Scaled:
    is_kink = np.abs(np.diff(operator.slope)) > NO_KINK
    is_kink[operator.zero] = True
    kinks = np.flatnonzero(is_kink)
    zero = int(np.searchsorted(kinks, operator.zero))
    slope = np.concatenate([operator.slope[kinks[: zero + 1]], operator.slope[kinks[zero:] + 1]])
    return replace(operator, knot=operator.knot[kinks], slope=slope, zero=zero)
