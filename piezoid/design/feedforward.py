"""Fit the reference filter and the preview that make the closed loop a pure delay."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.plant import Fraction
from piezoid.design.rst import ringing_mode
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.polynomial import (
    Response,
    polynomial_response,
    product,
    response,
    roots_of,
    unit_circle,
)

_GRID = 60
_TAPS = 7  # of the filter; at most 9: four sections of second order in the runtime
_LEAST_EFFORT = 1e-3
# Of the sampling rate: over the few samples of the taps, slower signals are nearly constant.
# Fitted up to 2 Hz at 20 kHz, the filters of three loops missed a reference of 100 Hz by 22 to 79
# %, fitted up to 20 Hz by 0.2 to 1.6 %.
_LEAST_BAND = 1e-3
# Of the lowest resonance: in a band that contains it, taps reach 1200 and amplify the reference.
_BELOW_MODE = 0.3
_PREVIEW_SLACK = 8  # samples tried beyond the delay of the loop
_GOOD_ENOUGH = 1.1  # times the smallest error


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePath:
    """Filter of the reference, and its preview in samples.

        r'[k] = sum_j f_j r[k + p - j],   S u = T r' - R y

    filter            (taps,)  f, sum 1
    preview_samples   p; if the reference is not known p samples ahead, the output follows it with
                      a pure delay of p samples
    band_Hz           up to which the filter was fitted
    error             max over f <= band of |1 - F H exp(j w p)|, nominal
    worst_error       the same over all members
    plain_error       nominal, without filter and preview
    """

    filter: Array
    preview_samples: int
    band_Hz: float
    error: float
    worst_error: float
    plain_error: float

    def __post_init__(self) -> None:
        freeze(self, "filter")


def fit_reference_path(
    members: Sequence[Fraction],
    R: ArrayLike,
    S: ArrayLike,
    T: ArrayLike,
    *,
    band_Hz: float,
) -> ReferencePath:
    """Fit the filter that makes the nominal closed loop a pure delay of p samples within a band.

    The loop's output is the position in front of the sensor, if the plant has one.

        minimise  sum_(f <= band) |F H - exp(-j w p)|^2 + small |F - 1|^2 above,   H = T B / P

    subject to F(1) = 1. The smallest preview whose error is within 10 % of the best is taken.

    members  the nominal one first
    band_Hz  raised to a thousandth of the sampling rate, or to 0.3 of the lowest resonance if that
             is less
    """
    nominal = members[0]
    rate_Hz = nominal.sampling_rate_Hz
    mode = ringing_mode(nominal)
    below_mode_Hz = np.inf if mode is None else _BELOW_MODE * mode.frequency_Hz
    band_Hz = max(band_Hz, min(_LEAST_BAND * rate_Hz, below_mode_Hz))
    inside = unit_circle(np.linspace(band_Hz / _GRID, band_Hz, _GRID), rate_Hz)
    outside = unit_circle(np.linspace(band_Hz, 0.5 * rate_Hz, _GRID), rate_Hz)
    closed = [closed_loop_polynomial(member, R, S) for member in members]
    tracked = [
        np.asarray(
            polynomial_response(T, inside)
            * polynomial_response(member.B_position, inside)
            / polynomial_response(P, inside)
        )
        for member, P in zip(members, closed, strict=True)
    ]
    low_Hz = 1e-4 * rate_Hz
    h = response(product(T, nominal.B_position), closed[0], [low_Hz], rate_Hz)[0]
    delay = int(np.ceil(-np.angle(h) / (2.0 * np.pi * low_Hz) * rate_Hz))  # at rest, in samples
    rows_in = tracked[0][:, None] * inside[:, None] ** np.arange(_TAPS)
    rows_out = _LEAST_EFFORT * outside[:, None] ** np.arange(_TAPS)
    rows = np.vstack([rows_in, rows_out])
    free = rows[:, 1:] - rows[:, :1]  # f = e_0 + differences: F(1) = 1 stays exact
    filters, errors = [], []
    for preview in range(max(delay, 0) + _PREVIEW_SLACK):
        target = np.concatenate([inside**preview, _LEAST_EFFORT * np.ones(len(outside))])
        offset = target - rows[:, 0]
        solution = np.linalg.lstsq(
            np.vstack([free.real, free.imag]),
            np.concatenate([offset.real, offset.imag]),
            rcond=None,
        )[0]
        filters.append(np.concatenate([[1.0 - solution.sum()], solution]))
        errors.append(_error(filters[-1], tracked[0], inside, preview))
    preview = next(k for k, error in enumerate(errors) if error <= _GOOD_ENOUGH * min(errors))
    coefficients = filters[preview]
    return ReferencePath(
        filter=coefficients,
        preview_samples=preview,
        band_Hz=band_Hz,
        error=errors[preview],
        worst_error=max(_error(coefficients, h, inside, preview) for h in tracked),
        plain_error=_error(np.ones(1), tracked[0], inside, 0),
    )


def filter_sections(coefficients: Array) -> Array:
    """Factor a filter with F(1) = 1 into sections b0 b1 b2 a1 a2 of unit gain at rest.

    coefficients  (taps,)
    returned      (ceil((taps - 1) / 2), 5)
    """
    roots = roots_of(coefficients)
    leading = int(np.flatnonzero(coefficients)[0])
    upper = roots[roots.imag > 1e-12]
    real = np.sort(roots[np.abs(roots.imag) <= 1e-12].real)
    factors = [np.array([1.0, -2.0 * root.real, abs(root) ** 2]) for root in upper]
    for k in range(0, len(real), 2):
        pair = [np.array([1.0, -root]) for root in real[k : k + 2]]
        factors.append(product(*pair))
    factors += [np.eye(3)[min(2, leading - k)] for k in range(0, leading, 2)]
    sections = np.zeros((len(factors), 5))
    for row, factor in zip(sections, factors, strict=True):
        row[: len(factor)] = factor / factor.sum()
    return sections


def _error(coefficients: Array, h: Response, q: Response, preview: int) -> float:
    return float(np.abs(1.0 - polynomial_response(coefficients, q) * h * q**-preview).max())
