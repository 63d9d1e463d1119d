"""Sensitivity functions and margins of a loop, from R, S and a plant alone.

Landau's notation: S u = T r - R y, P = A S + B R (Longchamp exchanges R and S).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar

from piezoid.design.plant import Fraction
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import (
    Response,
    decibel,
    grid_Hz,
    polynomial_response,
    response,
    unit_circle,
)
from piezoid.numerics.polynomial import product, spectral_radius, total

_LOWEST_Hz = 1e-3
_GRID = 4000
_REFINED_PEAKS = 3


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
    """Stability margins of a loop; recomputed from R, S and one plant.

    label               the plant's name
    is_stable           every root of P inside the unit circle
    spectral_radius     the largest magnitude of the roots of P
    modulus_margin      1 / max |Syp|, the distance of the Nyquist curve from -1; 0 if unstable
    modulus_peak_dB     max |Syp|
    modulus_Hz          where
    delay_margin_s      smallest additional loop delay that destabilises; None if none does
    delay_Hz            the gain crossing it belongs to; None likewise
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

    An unstable loop has both margins zero: its sensitivity peak means nothing.
    """
    radius = spectral_radius(closed_loop_polynomial(plant, R, S))
    peak, peak_Hz = _largest_sensitivity(plant, R, S)
    delay_s, delay_Hz = _delay_margin(plant, R, S)
    stable = radius < 1.0
    return Margins(
        label=plant.label,
        is_stable=stable,
        spectral_radius=radius,
        modulus_margin=1.0 / peak if stable else 0.0,
        modulus_peak_dB=float(decibel(peak)),
        modulus_Hz=peak_Hz,
        delay_margin_s=delay_s if stable else 0.0,
        delay_Hz=delay_Hz,
    )


def _fine_grid_Hz(plant: Fraction) -> Array:
    return grid_Hz(plant.sampling_rate_Hz, lowest_Hz=_LOWEST_Hz, count=_GRID)


def _largest_sensitivity(plant: Fraction, R: ArrayLike, S: ArrayLike) -> tuple[float, float]:
    """Return max |Syp| and its frequency: the highest grid points, each refined."""
    frequency_Hz = _fine_grid_Hz(plant)
    magnitude = np.abs(sensitivities(plant, R, S, frequency_Hz).Syp)
    inner = magnitude[1:-1]
    peaks = 1 + np.flatnonzero((inner >= magnitude[:-2]) & (inner >= magnitude[2:]))
    highest = peaks[np.argsort(magnitude[peaks])[::-1][:_REFINED_PEAKS]]
    end = int(np.argmax(magnitude))
    candidates = [(float(magnitude[end]), float(frequency_Hz[end]))]
    for k in highest:
        best = minimize_scalar(
            lambda f: -abs(sensitivities(plant, R, S, np.array([f])).Syp[0]),
            bounds=(frequency_Hz[k - 1], frequency_Hz[k + 1]),
            method="bounded",
            options={"xatol": 1e-6 * frequency_Hz[k]},
        )
        candidates.append((float(-best.fun), float(best.x)))
    return max(candidates)


def _delay_margin(
    plant: Fraction, R: ArrayLike, S: ArrayLike
) -> tuple[float | None, float | None]:
    """Return the smallest phase margin over frequency, in seconds, and the crossing's frequency.

    tau = min over |L(w)| = 1 of (angle(L) + pi mod 2 pi) / w, L = B R / (A S)
    """
    numerator, denominator = product(plant.B, R), product(plant.A, S)
    rate_Hz = plant.sampling_rate_Hz

    def loop(f: ArrayLike) -> Response:
        return response(numerator, denominator, np.atleast_1d(f), rate_Hz)

    frequency_Hz = _fine_grid_Hz(plant)
    excess = np.abs(loop(frequency_Hz)) - 1.0
    crossings = np.flatnonzero(np.sign(excess[:-1]) != np.sign(excess[1:]))
    candidates: list[tuple[float, float]] = []
    for k in crossings:
        f = brentq(lambda f: abs(loop(f)[0]) - 1.0, frequency_Hz[k], frequency_Hz[k + 1])
        phase = float(np.angle(-loop(f)[0])) % (2.0 * np.pi)
        candidates.append((phase / (2.0 * np.pi * f), float(f)))
    return min(candidates) if candidates else (None, None)
