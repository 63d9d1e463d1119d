"""The joint fit: play weights, dead zones, modes, damping, delay in one least-squares problem.

    minimise over all recordings   sum_lines |E(f)|^2 / sigma^2(f)

E is the spectrum of measured minus modelled displacement, each recording about its own straight
line, and sigma^2 the smoothed power of what is left: correlated noise, and what the operator does
not follow, weigh as little as they deserve [Whittle 1953]. Hysteresis and lag imitate each other;
here neither is fixed before the other is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.hammerstein_model import (
    HammersteinShape,
    simulate_rows,
    tangents,
)
from piezoid.identification.dynamics.hammerstein_rows import HammersteinRows
from piezoid.numerics.arrays import Array

ROUNDS = 3  # of new weights
STEPS = 4  # of Gauss-Newton between them
SMOOTH_PER_DECADE = 10
FEWEST_LINES = 12  # in one band of the noise's power
LONGEST_MOVE = 0.3  # of a logarithm in one step
NEIGHBOURS = 30  # samples over which whitened scores may still be correlated
HIGHEST = 0.4  # of a recording's rate: above, noise alone


@dataclass(frozen=True, kw_only=True, eq=False)
class HammersteinFit:
    """The parameters and how well they are known.

    theta       (parameters,)  laid out by the shape
    covariance  (parameters, parameters)
    start_rms_m  of what is left at the start, operator and dynamics found apart; each recording
    rms_m       of what is left at the end, each recording
    """

    shape: HammersteinShape
    theta: Array
    covariance: Array
    start_rms_m: tuple[float, ...]
    rms_m: tuple[float, ...]


def fit_hammerstein(
    rows: Sequence[HammersteinRows], shape: HammersteinShape, start: Array
) -> HammersteinFit:
    """Fit all parameters to all rows from a start, and state their covariance.

    The covariance is the larger, parameter by parameter, of the inverse curvature and of a
    sandwich over the whitened scores sample by sample, which sees noise that changes in time.
    """
    theta = start.copy()
    damping = 1e-3
    for _ in range(ROUNDS):
        weights = [_weights(_left(shape, theta, r), r) for r in rows]
        for _ in range(STEPS):
            curvature, gradient, cost = _normal(rows, shape, theta, weights)
            theta, damping, gained = _step(
                rows, shape, theta, weights, (curvature, gradient, cost), damping
            )
            if gained < 0.1:
                break
    weights = [_weights(_left(shape, theta, r), r) for r in rows]
    return HammersteinFit(
        shape=shape,
        theta=theta,
        covariance=_covariance(rows, shape, theta, weights),
        start_rms_m=tuple(float(np.std(_left(shape, start, r))) for r in rows),
        rms_m=tuple(float(np.std(_left(shape, theta, r))) for r in rows),
    )


def straightened(columns: Array) -> Array:
    """Return columns without their straight lines."""
    place = np.linspace(-1.0, 1.0, len(columns))
    level = columns - columns.mean(axis=0)
    return np.asarray(level - np.multiply.outer(place, place @ level / (place @ place)))


def _left(shape: HammersteinShape, theta: Array, rows: HammersteinRows) -> Array:
    return straightened(rows.measured_m - simulate_rows(shape, theta, rows))


def _weights(left_m: Array, rows: HammersteinRows) -> Array:
    """One over the standard deviation of each line; zero where nothing is to be fitted."""
    power = np.abs(rfft(left_m)) ** 2
    lines = np.arange(len(power))
    band = np.floor(SMOOTH_PER_DECADE * np.log10(np.maximum(lines / FEWEST_LINES, 1.0)))
    band = band.astype(np.int64)
    mean = np.bincount(band, power) / np.bincount(band)
    smooth = np.interp(lines, np.bincount(band, lines) / np.bincount(band), mean)
    weight = 1.0 / np.sqrt(np.maximum(smooth, 1e-300))
    weight[0] = 0.0
    weight[lines > HIGHEST * rows.samples] = 0.0
    return np.asarray(weight)


def _normal(
    rows: Sequence[HammersteinRows], shape: HammersteinShape, theta: Array, weights: list[Array]
) -> tuple[Array, Array, float]:
    curvature, gradient, cost = np.zeros((shape.size, shape.size)), np.zeros(shape.size), 0.0
    for held, weight in zip(rows, weights, strict=True):
        J = _weighted(straightened(tangents(shape, theta, held)), weight)
        e = _weighted(_left(shape, theta, held)[:, None], weight)[:, 0]
        curvature += (J.conj().T @ J).real
        gradient += (J.conj().T @ e).real
        cost += float(np.vdot(e, e).real)
    return curvature, gradient, cost


def _weighted(columns: Array, weight: Array) -> ComplexArray:
    # Half the spectrum of a real signal holds all of it: twice its squares are the whole sum.
    return np.asarray(rfft(columns, axis=0) * (np.sqrt(2.0) * weight)[:, None])


def _step(
    rows: Sequence[HammersteinRows],
    shape: HammersteinShape,
    theta: Array,
    weights: list[Array],
    normal: tuple[Array, Array, float],
    damping: float,
) -> tuple[Array, float, float]:
    """Damped steps until one lowers the cost; weights of plays stay at or above zero."""
    curvature, gradient, cost = normal
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    free = ~((theta <= 0.0) & (gradient < 0.0) & (np.arange(shape.size) < shape.plays))
    for _ in range(6):
        matrix = (curvature / np.outer(scale, scale))[np.ix_(free, free)]
        move = np.zeros(shape.size)
        move[free] = (
            np.linalg.solve(matrix + damping * np.eye(len(matrix)), (gradient / scale)[free])
            / scale[free]
        )
        new = _bounded(shape, theta, move)
        there = sum(
            float(np.sum(np.abs(_weighted(_left(shape, new, r)[:, None], w)) ** 2))
            for r, w in zip(rows, weights, strict=True)
        )
        if there < cost:
            return new, max(damping / 10.0, 1e-10), cost - there
        damping *= 10.0
    return theta, damping, 0.0


def _bounded(shape: HammersteinShape, theta: Array, move: Array) -> Array:
    logs = slice(shape.linear.start, shape.linear.stop - 1)
    move = move.copy()
    move[logs] = np.clip(move[logs], -LONGEST_MOVE, LONGEST_MOVE)
    new = theta + move
    new[: shape.plays] = np.maximum(new[: shape.plays], 0.0)
    new[shape.linear.stop - 1] = max(new[shape.linear.stop - 1], 0.0)
    return new


def _covariance(
    rows: Sequence[HammersteinRows], shape: HammersteinShape, theta: Array, weights: list[Array]
) -> Array:
    curvature, meat = np.zeros((shape.size, shape.size)), np.zeros((shape.size, shape.size))
    for held, weight in zip(rows, weights, strict=True):
        J = straightened(tangents(shape, theta, held))
        white = _whitened(np.column_stack([J, _left(shape, theta, held)]), weight)
        scores = white[:, :-1] * white[:, -1:]
        curvature += white[:, :-1].T @ white[:, :-1]
        meat += _long_run(scores)
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    inverse = np.linalg.pinv(curvature / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    inverse = inverse / np.outer(scale, scale)
    sandwich = inverse @ meat @ inverse
    stretch = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300), 1.0))
    return np.asarray(inverse * np.outer(stretch, stretch))


def _whitened(columns: Array, weight: Array) -> Array:
    """Columns in time, each line over its standard deviation: unit variance and white."""
    spectrum = rfft(columns, axis=0) * weight[:, None]
    return np.asarray(irfft(spectrum, len(columns), axis=0) * np.sqrt(len(columns)))


def _long_run(scores: Array) -> Array:
    """Sum of products of scores, neighbours with falling weight [Newey & West 1987]."""
    total: Array = scores.T @ scores
    for lag in range(1, NEIGHBOURS):
        both = scores[lag:].T @ scores[:-lag]
        total = total + (1.0 - lag / NEIGHBOURS) * (both + both.T)
    return total
