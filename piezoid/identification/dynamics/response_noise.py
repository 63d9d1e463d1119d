"""How surely each line of a measured response is known, where its file tells little of that.

    var G = a^2 + b^2 |G|^2                                    without coherence
    var G = c |G|^2 (1 - coherence) / coherence                with it        [Bendat & Piersol]

a, b or c come from how the residual of neighbouring lines differs [von Neumann 1941]: what a model
leaves that is smooth, because a mode is missing, does not count as noise.
"""

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.dynamics.periodic_estimate import smoothed
from piezoid.numerics.arrays import Array, ComplexArray

RATIOS = np.concatenate([[0.0], np.geomspace(1e-8, 1e4, 61)])  # of a^2 to b^2 |G|^2 at its median
NEIGHBOURS = 5  # lines over which a measured coherence is smoothed: each scatters by itself
LEAST_SHARE = 0.1  # of the median of (1 - coherence) / coherence: printed 1.000 is no certainty
ROUGH_LINES = 21
ROUGH_FLOOR = 1e-3  # of the gain
ALONE = 6.0  # standard deviations: one line of 10^8 by chance
BESIDE = 3.0


def rough_variance(response: ComplexArray) -> Array:
    """Return a first guess from how the logarithm of the response bends from line to line."""
    log = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    bend = np.abs(np.diff(log, 2)) ** 2 / 6.0 * 2.0
    bend = np.concatenate([bend[:1], bend, bend[-1:]])
    half = min(ROUGH_LINES, len(bend)) // 2
    padded = np.pad(bend, half, mode="reflect" if len(bend) > half else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    return np.asarray(np.abs(response) ** 2 * (np.median(windows, axis=1) + ROUGH_FLOOR**2))


def variance_of(response: ComplexArray, residual: ComplexArray, coherence: Array | None) -> Array:
    """Return the variance of each line, (lines,) m2/V2.

    residual   what a model leaves of the response
    coherence  where it was measured
    """
    shown = 0.5 * np.abs(np.diff(residual)) ** 2
    if coherence is not None:
        share = (1.0 - coherence) / coherence
        width = min(NEIGHBOURS, (len(share) - 1) // 2 * 2 + 1)
        smooth = smoothed(share[:, None], width)[:, 0]
        floor = LEAST_SHARE * float(np.median(smooth))
        shape = np.abs(response) ** 2 * np.maximum(smooth, floor if floor > 0.0 else 1.0)
        return np.asarray(shape * _scale(shown, shape))
    power = np.abs(response) ** 2
    shapes = [ratio * float(np.median(power)) + power for ratio in RATIOS]
    shapes.append(np.full(len(power), float(np.median(power))))
    found = [(_surprise(shown, shape), k) for k, shape in enumerate(shapes)]
    best = shapes[min(found)[1]]
    return np.asarray(best * _scale(shown, best))


def _pairs(shape: Array) -> Array:
    return np.asarray(0.5 * (shape[1:] + shape[:-1]))


def _scale(shown: Array, shape: Array) -> float:
    return max(float(np.mean(shown / _pairs(shape))), float(np.finfo(np.float64).tiny))


def _surprise(shown: Array, shape: Array) -> float:
    """Minus twice the mean log likelihood of squared complex differences, the scale eliminated."""
    return float(np.mean(np.log(_pairs(shape)))) + float(np.log(_scale(shown, shape)))


def standing_alone(residual: ComplexArray, variance: Array) -> NDArray[np.bool_]:
    """Tell the single lines that stand out from a model and from both of their neighbours."""
    size = np.abs(residual) / np.sqrt(variance)
    size = size / max(float(np.median(size)) / np.sqrt(np.log(2.0)), 1e-300)
    beside = np.pad(size, 1, mode="reflect")
    calm = (beside[:-2] < BESIDE) & (beside[2:] < BESIDE)
    return np.asarray((size > ALONE) & calm)
