"""The same fit with fewer parts: plays without weight go, neighbours too close to tell merge."""

from dataclasses import replace

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates, Scaled, vector_of
from piezoid.identification.hysteresis.gauss_newton import minimise
from piezoid.identification.hysteresis.search import Fitted
from piezoid.numerics.arrays import Array

CLOSE_GAP = 0.01  # of half the drive's range: thresholds nearer than that are one
NO_WEIGHT = 1e-4  # of the total slope
NO_KINK = 1e-3  # a change of slope that is none
NO_WORSE = 1.002


def simplified(fitted: Fitted, *, iterations: int) -> Fitted:
    """Return the fit without its superfluous plays and kinks, if it is as good without them."""
    operator = _thinned_zones(_thinned_plays(fitted.operator))
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


def _thinned_plays(operator: Scaled) -> Scaled:
    threshold = [0.0]
    weight = [float(operator.weight[0])]
    least = NO_WEIGHT * float(operator.weight.sum())
    for r, w in zip(operator.threshold, operator.weight[1:], strict=True):
        if w <= least:
            continue
        if r - threshold[-1] < CLOSE_GAP and len(threshold) > 1:
            share = w / (w + weight[-1])
            threshold[-1] += share * (r - threshold[-1])
            weight[-1] += w
        else:
            threshold.append(float(r))
            weight.append(float(w))
    moving = np.array(threshold[1:])
    return replace(
        operator,
        gap=np.diff(moving, prepend=0.0),
        threshold=moving,
        weight=np.array(weight),
    )


def _thinned_zones(operator: Scaled) -> Scaled:
    jump = np.abs(np.diff(operator.slope))
    keep = jump > NO_KINK
    keep[operator.zero] = True
    kept = np.flatnonzero(keep)
    zero = int(np.searchsorted(kept, operator.zero))
    slope = np.concatenate([operator.slope[kept[: zero + 1]], operator.slope[kept[zero:] + 1]])
    return replace(operator, knot=operator.knot[kept], slope=slope, zero=zero)
