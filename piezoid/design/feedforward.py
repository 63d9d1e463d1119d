"""Fit the reference filter and the preview that make the closed loop a pure delay."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.frequency import Response, polynomial_response, response, unit_circle
from piezoid.numerics.polynomial import product, roots_of

_GRID = 60
_LEAST_EFFORT = 1e-3
_PREVIEW_SLACK = 8
_GOOD_ENOUGH = 1.1


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencePath:
    """A filter on the reference, and by how many samples the reference must lead.

        r'[k] = sum_j f_j r[k + p - j],   S u = T r' - R y

    filter            (taps,)  f, sum 1
    preview_samples   p: the output follows the reference of p samples ago when p is not known
                      ahead; then the same numbers describe a pure delay, not an error
    band_Hz           where the filter was fitted
    error             max over f <= band of |1 - F H exp(j w p)|, nominal
    worst_error       likewise, over all members
    plain_error       nominal, without filter and preview: what lag alone would have cost
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
    taps: int = 7,
) -> ReferencePath:
    """Fit the filter that makes the nominal closed loop a pure delay of p samples within a band.

    The loop's output is the position, in front of the sensor, where that is known.

        minimise  sum_(f <= band) |F H - exp(-j w p)|^2 + small |F - 1|^2 above,   H = T B / P

    subject to F(1) = 1. The smallest preview within 10 % of the best error is taken.

    members  the nominal one first
    taps     at most 9: four sections of second order in the runtime
    """
    nominal = members[0]
    rate_Hz = nominal.sampling_rate_Hz
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
    fits = [
        (_fit(tracked[0], inside, outside, preview, taps), preview)
        for preview in range(max(delay, 0) + _PREVIEW_SLACK)
    ]
    errors = [_error(f, tracked[0], inside, preview) for f, preview in fits]
    index = next(k for k, error in enumerate(errors) if error <= _GOOD_ENOUGH * min(errors))
    coefficients, preview = fits[index]
    return ReferencePath(
        filter=coefficients,
        preview_samples=preview,
        band_Hz=band_Hz,
        error=errors[index],
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


def _fit(h: Response, inside: Response, outside: Response, preview: int, taps: int) -> Array:
    """Solve the least squares with the sum of taps fixed at one."""
    rows_in = h[:, None] * inside[:, None] ** np.arange(taps)
    rows_out = _LEAST_EFFORT * outside[:, None] ** np.arange(taps)
    rows = np.vstack([rows_in, rows_out])
    target = np.concatenate([inside**preview, _LEAST_EFFORT * np.ones(len(outside))])
    # f = e_0 + differences: F(1) = 1 stays exact.
    free = rows[:, 1:] - rows[:, :1]
    remainder = target - rows[:, 0]
    solution = np.linalg.lstsq(
        np.vstack([free.real, free.imag]),
        np.concatenate([remainder.real, remainder.imag]),
        rcond=None,
    )[0]
    return np.concatenate([[1.0 - solution.sum()], solution])


def _error(coefficients: Array, h: Response, q: Response, preview: int) -> float:
    return float(np.abs(1.0 - polynomial_response(coefficients, q) * h * q**-preview).max())
