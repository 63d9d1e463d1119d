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
from piezoid.identification.hysteresis.gauss_newton import Minimum, Task, minimise, simulate
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.start import (
    find_lag,
    gathered_thresholds,
    kuhnen_start,
    linear_start,
)
from piezoid.numerics.arrays import Array

FEW = 6  # plays: with more, the better of two starts is enough
# Ridge, scaled: kinks of 0.1 cost 1e-11, a thousandth of the square of the finest noise (1e-4).
WEAK = 1e-9
THRESHOLDS = ("gap", "below_gap", "above_gap")
SHARED = tuple(Coordinates(shape=Shape(plays=0, below=0, above=0), offsets=()).slices)
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
    """

    longest_lag_s: float
    sensor_pole_Hz: float | None = None
    rows: int = 8000
    follow_zero: bool = True
    iterations: int = 30
    lag_s: float | None = None


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
    settled = sorted(
        (
            _settled(
                pieces,
                bent(start.operator, shape.bends),
                shape.lag,
                settings,
                fixed=THRESHOLDS,
                offset=start.offset,
                kkt_gap=start.kkt_gap,
            )
            for start in starts
        ),
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
    return _searched(_settled(pieces, operator, lag, settings, fixed=SHARED), settings)


def _searched(start: Fitted, settings: Settings) -> Fitted:
    minimum = minimise(start.minimum.theta, start.task, iterations=settings.iterations)
    return replace(start, minimum=minimum)


def _settled(
    pieces: Sequence[Piece],
    operator: Scaled,
    lag: str,
    settings: Settings,
    *,
    fixed: tuple[str, ...],
    offset: float = 0.0,
    kkt_gap: float = 0.0,
) -> Fitted:
    """Optimise everything but some shared numbers, in a third of the iterations.

    offset  scaled displacement at which the zeros of the pieces begin
    """
    task = task_for(pieces, operator, lag, settings)
    theta = vector_of(operator, task.coordinates)
    for index in range(len(pieces)):
        theta[task.coordinates.offset_slice(index)] = offset
    minimum = minimise(theta, replace(task, fixed=fixed), iterations=settings.iterations // 3)
    return Fitted(task=task, minimum=minimum, kkt_gap=kkt_gap)


def task_for(pieces: Sequence[Piece], operator: Scaled, lag: str, settings: Settings) -> Task:
    """Return the task whose vector can hold this operator on these pieces."""
    offsets = [1] * len(pieces)
    if settings.follow_zero:  # one knot, and one more for every four cycles: slower than any loop
        levels = [np.signbit(p.fitted_drive - np.median(p.fitted_drive)) for p in pieces]
        crossings = [int(np.count_nonzero(np.diff(is_low))) for is_low in levels]
        offsets = [1 + min(count // 8, 12) for count in crossings]
    return Task(
        pieces=tuple(pieces),
        coordinates=Coordinates(shape=operator.shape(lag), offsets=tuple(offsets)),
        sensor_pole_Hz=settings.sensor_pole_Hz,
        stride=max(1, sum(piece.rows for piece in pieces) // settings.rows),
        longest_lag_s=settings.longest_lag_s,
        ridge=WEAK,
    )


def continued(fitted: Fitted, index: int, piece: Piece) -> Array:
    """Simulate a longer piece with the fitted parameters and zero."""
    return simulate(fitted.minimum.theta, fitted.task, index, piece)


def transferred(fitted: Fitted, pieces: Sequence[Piece]) -> Fitted:
    """Fit only the zero and the initial memory of other pieces, with the operator fixed."""
    settings = Settings(
        longest_lag_s=fitted.task.longest_lag_s,
        sensor_pole_Hz=fitted.task.sensor_pole_Hz,
        follow_zero=False,
        iterations=36,
    )
    return _settled(pieces, fitted.operator, fitted.shape.lag, settings, fixed=SHARED)


def simplified(fitted: Fitted, *, iterations: int) -> Fitted:
    """Return the fit without its superfluous plays and kinks, if it is as good without them."""
    before, old = fitted.operator, fitted.task.coordinates
    operator = _without_small_parts(before)
    if len(operator.gap) == len(before.gap) and len(operator.knot) == len(before.knot):
        return fitted
    coordinates = Coordinates(shape=operator.shape(fitted.shape.lag), offsets=old.offsets)
    task, theta = replace(fitted.task, coordinates=coordinates), vector_of(operator, coordinates)
    radius = np.concatenate([[0.0], before.threshold])
    for index in range(len(old.offsets)):
        theta[coordinates.offset_slice(index)] = fitted.minimum.theta[old.offset_slice(index)]
        # Memory slopes that give the remaining plays the states they had.
        slopes = fitted.minimum.theta[old.memory_slice(index)]
        curve = np.concatenate([[0.0], np.cumsum(before.gap * slopes)])
        state = np.interp(operator.threshold, radius, curve)
        slopes = np.clip(np.diff(state, prepend=0.0) / operator.gap, -1.0, 1.0)
        theta[coordinates.memory_slice(index)] = slopes
    minimum = minimise(theta, task, iterations=iterations)
    if minimum.rms > NO_WORSE * fitted.minimum.rms:
        return fitted
    return replace(fitted, task=task, minimum=minimum)


def _without_small_parts(operator: Scaled) -> Scaled:
    """Drop plays of negligible weight and kinks, and join plays of nearly equal threshold."""
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
    is_kink = np.abs(np.diff(operator.slope)) > NO_KINK
    is_kink[operator.zero] = True
    kinks = np.flatnonzero(is_kink)
    zero = int(np.searchsorted(kinks, operator.zero))
    return replace(
        operator,
        gap=np.diff(moving, prepend=0.0),
        threshold=moving,
        weight=np.array(weight),
        knot=operator.knot[kinks],
        slope=np.concatenate(
            [operator.slope[kinks[: zero + 1]], operator.slope[kinks[zero:] + 1]]
        ),
        zero=zero,
    )
