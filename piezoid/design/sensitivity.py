"""Sensitivity functions and margins of a loop, from R, S and a plant alone.

Landau's notation: S u = T r - R y, P = A S + B R (Longchamp exchanges R and S).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.plant import Fraction
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import (
    Response,
    decibel,
    grid_Hz,
    polynomial_response,
    product,
    response,
    spectral_radius,
    total,
    unit_circle,
)

_LOWEST_Hz = 1e-3
_GRID = 4000
_REFINED_PEAKS = 3
# Brackets of 1 % shrink to 1e-8 in 1.8 ms for one plant. Bracketed root finding, one crossing at a
# time, takes 4.1 ms for the same margins to 1e-7.
_SUBDIVISIONS, _LINES = 6, 21


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivities:
    """The four sensitivity functions of a loop, (frequencies,) each.

    Syp   A S / P     output disturbance to output; 1
    Sup   -A R / P    output disturbance to control; V per output unit
    Syb   -B R / P    measurement noise to output (complementary); 1
    Syv   B S / P     input disturbance to output; output unit per V
    """

    frequency_Hz: Array
    Syp: Response
    Sup: Response
    Syb: Response
    Syv: Response


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Stability margins of a loop, computed from R, S and one plant.

    label               the plant's name
    is_stable           every root of P lies inside the unit circle
    spectral_radius     largest magnitude of the roots of P
    modulus_margin      1 / max |Syp|, the distance of the Nyquist curve from -1; 0 if unstable
    modulus_peak_dB     max |Syp|
    modulus_Hz          frequency of that maximum
    delay_margin_s      smallest additional loop delay that destabilises; None: no delay does
    delay_Hz            frequency of the corresponding gain crossing; None without one
    """

    label: str
    is_stable: bool
    spectral_radius: float
    modulus_margin: float
    modulus_peak_dB: float
    modulus_Hz: float
    delay_margin_s: float | None
    delay_Hz: float | None


def closed_loop_polynomial(plant: Fraction, R: ArrayLike, S: ArrayLike) -> Array:
    """Return P = A S + B R."""
    return total(product(plant.A, S), product(plant.B, R))


def sensitivities(
    plant: Fraction, R: ArrayLike, S: ArrayLike, frequency_Hz: Array
) -> Sensitivities:
    """Return the sensitivity functions of a loop.

    R, S          coefficients in q^-1
    frequency_Hz  (frequencies,)
    """
    q = unit_circle(frequency_Hz, plant.sampling_rate_Hz)
    a, b, r, s = (polynomial_response(p, q) for p in (plant.A, plant.B, R, S))
    p = a * s + b * r
    return Sensitivities(
        frequency_Hz=frequency_Hz,
        Syp=np.asarray(a * s / p),
        Sup=np.asarray(-a * r / p),
        Syb=np.asarray(-b * r / p),
        Syv=np.asarray(b * s / p),
    )


def margins(plant: Fraction, R: ArrayLike, S: ArrayLike) -> Margins:
    """Return the margins of one plant's loop, refined between grid points.

    Both margins of an unstable loop are zero: its sensitivity peak has no meaning.
    """
    radius = spectral_radius(closed_loop_polynomial(plant, R, S))
    peak, peak_Hz = _largest_sensitivity(plant, R, S)
    delay_s, delay_Hz = _delay_margin(plant, R, S)
    is_stable = radius < 1.0
    return Margins(
        label=plant.label,
        is_stable=is_stable,
        spectral_radius=radius,
        modulus_margin=1.0 / peak if is_stable else 0.0,
        modulus_peak_dB=float(decibel(peak)),
        modulus_Hz=peak_Hz,
        delay_margin_s=delay_s if is_stable else 0.0,
        delay_Hz=delay_Hz,
    )


def _fine_grid_Hz(plant: Fraction) -> Array:
    return grid_Hz(plant.sampling_rate_Hz, lowest_Hz=_LOWEST_Hz, count=_GRID)


def _largest_sensitivity(plant: Fraction, R: ArrayLike, S: ArrayLike) -> tuple[float, float]:
    """Return max |Syp| and its frequency, refined about the highest peaks of the grid."""

    def negative(f: Array) -> Array:
        return -np.abs(sensitivities(plant, R, S, f).Syp)

    frequency_Hz = _fine_grid_Hz(plant)
    values = negative(frequency_Hz)
    inner = values[1:-1]
    peaks = 1 + np.flatnonzero((inner <= values[:-2]) & (inner <= values[2:]))
    highest = peaks[np.argsort(values[peaks])[:_REFINED_PEAKS]]
    refined_Hz = _minimisers(negative, frequency_Hz[highest - 1], frequency_Hz[highest + 1])
    candidates_Hz = np.append(refined_Hz, frequency_Hz[np.argmin(values)])
    values = negative(candidates_Hz)
    best = int(np.argmin(values))
    return -float(values[best]), float(candidates_Hz[best])


def _delay_margin(
    plant: Fraction, R: ArrayLike, S: ArrayLike
) -> tuple[float | None, float | None]:
    """Return the smallest phase margin over frequency, in seconds, and the crossing's frequency.

    tau = min over |L(w)| = 1 of (angle(L) + pi mod 2 pi) / w, L = B R / (A S)
    """
    numerator, denominator = product(plant.B, R), product(plant.A, S)

    def loop(f: Array) -> Response:
        return response(numerator, denominator, f, plant.sampling_rate_Hz)

    frequency_Hz = _fine_grid_Hz(plant)
    is_above = np.abs(loop(frequency_Hz)) > 1.0
    k = np.flatnonzero(is_above[:-1] != is_above[1:])
    if not len(k):
        return None, None
    crossings_Hz = _minimisers(
        lambda f: np.abs(np.abs(loop(f)) - 1.0), frequency_Hz[k], frequency_Hz[k + 1]
    )
    delay_s = np.angle(-loop(crossings_Hz)) % (2.0 * np.pi) / (2.0 * np.pi * crossings_Hz)
    smallest = int(np.argmin(delay_s))
    return float(delay_s[smallest]), float(crossings_Hz[smallest])


def _minimisers(function: Callable[[Array], Array], low_Hz: Array, high_Hz: Array) -> Array:
    """Return the frequency of the smallest value in each bracket, by repeated subdivision."""
    brackets = np.arange(len(low_Hz))
    for _ in range(_SUBDIVISIONS):
        f = np.linspace(low_Hz, high_Hz, _LINES)
        best = np.argmin(function(f), axis=0)
        low_Hz = f[np.maximum(best - 1, 0), brackets]
        high_Hz = f[np.minimum(best + 1, _LINES - 1), brackets]
    return 0.5 * (low_Hz + high_Hz)
