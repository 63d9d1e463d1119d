"""Linear filters of one signal or of many columns, steady before the first sample."""

from functools import lru_cache

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.linear import recursive_filter


def rung(moved: Array, frequency_Hz: float, quality: float, rate_Hz: float) -> Array:
    """Return a signal behind one mode, x'' + (w / Q) x' + w^2 x = w^2 u, straight between samples.

    moved  (samples,) or (samples, columns)
    """
    fraction, start = _mode(frequency_Hz, quality, rate_Hz), moved[:1]
    changes = (moved - start).reshape(len(moved), -1).T
    rung_up = [recursive_filter(*fraction, change) for change in changes]
    return np.asarray(np.stack(rung_up, axis=-1).reshape(moved.shape) + start)


@lru_cache(maxsize=256)
def _mode(frequency_Hz: float, quality: float, rate_Hz: float) -> tuple[Array, Array]:
    """Return numerator and denominator of the exact sampling behind a first-order hold."""
    from scipy.signal import cont2discrete

    w = 2.0 * np.pi * frequency_Hz
    system = ([w * w], [1.0, w / quality, w * w])
    b, a, _ = cont2discrete(system, 1.0 / rate_Hz, method="foh")
    return np.asarray(b).ravel(), np.asarray(a)


def hats(place: Array, knots: int) -> Array:
    """Return smooth hats with their tops at 0, 1, .. knots - 1, (samples, knots); they add to 1.

    place  (samples,)  0 to knots - 1; what lies outside counts as the end
    """
    away = np.abs(np.clip(place, 0.0, knots - 1.0)[:, None] - np.arange(knots))
    return np.asarray(np.where(away < 1.0, 0.5 * (1.0 + np.cos(np.pi * away)), 0.0))
