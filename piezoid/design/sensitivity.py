"""Sensitivity functions of a loop, its margins, and templates that bound the functions.

All are computed from R, S and a plant alone. Landau's notation: S u = T r - R y, P = A S + B R
(Longchamp exchanges R and S).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.plant import Fraction
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array, freeze, same_length, strictly_increasing
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

ATTENUATION = "attenuation"  # name of the template of the bandwidth
FUNCTIONS = ("Syp", "Sup", "Syb", "Syv")
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

        delay margin = min over |L(w)| = 1 of (angle(L) + pi mod 2 pi) / w,   L = B R / (A S)

    Both margins of an unstable loop are zero: its sensitivity peak has no meaning.
    """
    numerator, denominator = product(plant.B, R), product(plant.A, S)

    def negative(f: Array) -> Array:
        return -np.abs(sensitivities(plant, R, S, f).Syp)

    def loop(f: Array) -> Response:
        return response(numerator, denominator, f, plant.sampling_rate_Hz)

    # The largest |Syp|, refined about the highest peaks of the grid.
    frequency_Hz = grid_Hz(plant.sampling_rate_Hz, lowest_Hz=_LOWEST_Hz, count=_GRID)
    values = negative(frequency_Hz)
    inner = values[1:-1]
    peaks = 1 + np.flatnonzero((inner <= values[:-2]) & (inner <= values[2:]))
    highest = peaks[np.argsort(values[peaks])[:_REFINED_PEAKS]]
    refined_Hz = _minimisers(negative, frequency_Hz[highest - 1], frequency_Hz[highest + 1])
    candidates_Hz = np.append(refined_Hz, frequency_Hz[np.argmin(values)])
    values = negative(candidates_Hz)
    best = int(np.argmin(values))
    peak = -float(values[best])
    # The smallest delay at a gain crossing.
    delay_s: float | None = None
    delay_Hz: float | None = None
    is_above = np.abs(loop(frequency_Hz)) > 1.0
    k = np.flatnonzero(is_above[:-1] != is_above[1:])
    if len(k):
        crossings_Hz = _minimisers(
            lambda f: np.abs(np.abs(loop(f)) - 1.0), frequency_Hz[k], frequency_Hz[k + 1]
        )
        delays_s = np.angle(-loop(crossings_Hz)) % (2.0 * np.pi) / (2.0 * np.pi * crossings_Hz)
        smallest = int(np.argmin(delays_s))
        delay_s, delay_Hz = float(delays_s[smallest]), float(crossings_Hz[smallest])
    radius = spectral_radius(closed_loop_polynomial(plant, R, S))
    is_stable = radius < 1.0
    return Margins(
        label=plant.label,
        is_stable=is_stable,
        spectral_radius=radius,
        modulus_margin=1.0 / peak if is_stable else 0.0,
        modulus_peak_dB=float(decibel(peak)),
        modulus_Hz=float(candidates_Hz[best]),
        delay_margin_s=delay_s if is_stable else 0.0,
        delay_Hz=delay_Hz,
    )


def _minimisers(function: Callable[[Array], Array], low_Hz: Array, high_Hz: Array) -> Array:
    """Return the frequency of the smallest value in each bracket, by repeated subdivision."""
    brackets = np.arange(len(low_Hz))
    for _ in range(_SUBDIVISIONS):
        f = np.linspace(low_Hz, high_Hz, _LINES)
        best = np.argmin(function(f), axis=0)
        low_Hz = f[np.maximum(best - 1, 0), brackets]
        high_Hz = f[np.minimum(best + 1, _LINES - 1), brackets]
    return 0.5 * (low_Hz + high_Hz)


@dataclass(frozen=True, kw_only=True, eq=False)
class Template:
    """An upper limit of one sensitivity function.

    name          for messages, for example ``attenuation``
    function      one of Syp, Sup, Syb, Syv
    frequency_Hz  (knots,)  increasing; the limit is linear in dB over log f between knots, and
                  infinite outside
    upper_dB      (knots,)  relative to 1, V per output unit, 1, output unit per V
    """

    name: str
    function: str
    frequency_Hz: Array
    upper_dB: Array

    def __post_init__(self) -> None:
        if self.function not in FUNCTIONS:
            raise ValueError(f"template {self.name}: {self.function!r} is not one of {FUNCTIONS}")
        freeze(self, "frequency_Hz", "upper_dB")
        same_length([("frequency_Hz", self.frequency_Hz), ("upper_dB", self.upper_dB)])
        strictly_increasing(self.frequency_Hz, "frequency_Hz")
        if not len(self.frequency_Hz):
            raise ValueError(f"template {self.name}: it has no frequencies")
        if not self.frequency_Hz[0] > 0:
            raise ValueError(f"template {self.name}: frequencies must be > 0")

    def limit_dB(self, frequency_Hz: ArrayLike) -> Array:
        """Return the limit in dB, +inf outside of the knots, (frequencies,)."""
        f = np.asarray(frequency_Hz, dtype=np.float64)
        level = np.interp(np.log(f), np.log(self.frequency_Hz), self.upper_dB)
        inside = (f >= self.frequency_Hz[0]) & (f <= self.frequency_Hz[-1])
        return np.where(inside, level, np.inf)


@dataclass(frozen=True, kw_only=True)
class Violation:
    """Violation of one template by one member of the family, at its worst frequency.

    template      name of the template or margin
    member        label of the plant
    frequency_Hz  of the largest excess
    found, limit  in ``unit``: ``dB``, or ``s`` for the delay margin, ``1`` for the modulus margin
    excess_dB     20 log10 of the ratio to the limit, > 0
    """

    template: str
    member: str
    frequency_Hz: float
    found: float
    limit: float
    unit: str
    excess_dB: float

    @property
    def sentence(self) -> str:
        """The violation as a sentence."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (
            f"{self.template} of the member '{self.member}' is {significant(self.found, 4)}{unit} "
            f"at {with_unit(self.frequency_Hz, 'Hz')}; the limit, {significant(self.limit, 4)}"
            f"{unit}, is missed by {self.excess_dB:.2f} dB"
        )


def attenuation(bandwidth_Hz: float, level_dB: float) -> Template:
    """Return the template of an integrating loop: |Syp| rises by 20 dB/decade up to a level."""
    return Template(
        name=ATTENUATION,
        function="Syp",
        frequency_Hz=np.array([bandwidth_Hz / 1000.0, bandwidth_Hz]),
        upper_dB=np.array([level_dB - 60.0, level_dB]),
    )


def constant_limit(
    name: str, function: str, band_Hz: tuple[float, float], level_dB: float
) -> Template:
    """Return the template of one level within a band."""
    return Template(
        name=name,
        function=function,
        frequency_Hz=np.array(band_Hz),
        upper_dB=np.full(2, level_dB),
    )


def delay_limit(frequency_Hz: Array, delay_s: float) -> Array:
    """Return the limit of |Syb| below which every additional delay up to tau preserves stability.

        1 / max over t <= tau of |1 - exp(-j w t)|:   1/(2 sin(w tau / 2)), 1/2 from w tau = pi on

    For tau of one sample this is Landau's template. Above one sample, delays less than tau
    determine the limit at high frequency, which the first expression alone would miss.
    """
    angle = np.minimum(np.pi * frequency_Hz * delay_s, 0.5 * np.pi)
    return np.asarray(0.5 / np.maximum(np.sin(angle), 1e-12))
