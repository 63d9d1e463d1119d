"""Frequency grids, responses of fractions in q^-1, decibels."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezoid.numerics.arrays import Array

Response = NDArray[np.complex128]


def grid_Hz(sampling_rate_Hz: float, *, lowest_Hz: float = 1.0, count: int = 400) -> Array:
    """Return frequencies from ``lowest_Hz`` to just below Nyquist.

    Half of them are spaced by equal ratios, for loop shaping over decades, and half by equal
    differences, for the peaks and delays in the last decade.

    returned  (about count,)  Hz, strictly increasing
    """
    highest_Hz = 0.4999 * sampling_rate_Hz
    half = max(count // 2, 2)
    by_ratio = np.geomspace(lowest_Hz, highest_Hz, half)
    by_difference = np.linspace(highest_Hz / half, highest_Hz, half)
    return np.unique(np.concatenate([by_ratio, by_difference]))


def unit_circle(frequency_Hz: ArrayLike, sampling_rate_Hz: float) -> Response:
    """Return q^-1 = exp(-2 pi j f / fs), (frequencies,)."""
    turns = np.asarray(frequency_Hz, dtype=np.float64) / sampling_rate_Hz
    return np.asarray(np.exp(-2j * np.pi * turns))


def polynomial_response(polynomial: ArrayLike, delay_operator: Response) -> Response:
    """Return p(q^-1) on given values of q^-1."""
    coefficients = np.asarray(polynomial, dtype=np.float64).tolist()
    value = np.full(delay_operator.shape, coefficients[-1], dtype=np.complex128)
    for coefficient in coefficients[-2::-1]:
        value *= delay_operator
        value += coefficient
    return value


def response(B: ArrayLike, A: ArrayLike, frequency_Hz: ArrayLike, rate_Hz: float) -> Response:
    """Return B/A on the unit circle, (frequencies,); the delay is leading zeros of B."""
    q = unit_circle(frequency_Hz, rate_Hz)
    return np.asarray(polynomial_response(B, q) / polynomial_response(A, q))


def decibel(magnitude: ArrayLike) -> Array:
    """Return 20 log10 |magnitude|; zero becomes -inf."""
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(np.abs(np.asarray(magnitude))))
