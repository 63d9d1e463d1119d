"""Fit modes, lags and delay to a frequency response by maximum likelihood.

1. Vector fitting with several trial delays gives a start.
2. The weighted output error is minimised over the shape, with the gains eliminated.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import (
    Declaration,
    LinearDynamics,
    SlowPart,
    Structure,
)
from piezoid.identification.dynamics.vector_fitting import (
    stack_parts,
    start_poles,
    vector_fit,
    weighted_misfit,
)
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, eliminate, minimise
from piezoid.numerics.robust import sandwich_covariance
from piezoid.operators.linear import sampled_fractions

# Half of ``enough`` is the gain in log likelihood: a tenth of a standard deviation.
RULE = Rule(tolerance=0.0, enough=1e-2, evaluations=40)
STEP = 1e-5  # of the central differences: truncation 1e-10, rounding 1e-11
MAX_LOG_STEP = 0.3
OUT_OF_BAND = 4.0  # largest damping, and largest ratio of a pole to the edge of the band
MIN_DAMPING = 1e-5
START_LINES = 500  # on which trial delays are compared
START_ROUNDS, FINAL_ROUNDS = 6, 12


def fit_dynamics(
    measured: FrequencyResponse, structure: Structure, declaration: Declaration
) -> LinearDynamics:
    """Fit the modal form to a measured response by maximum likelihood.

        minimise sum |G_hat - G(theta)|^2 / variance                [Pintelon & Schoukens 2012]

    measured     response of one axis with its variances; rejected lines are not fitted
    structure    numbers of modes and lags, direct term
    declaration  hold and declared filters

    The covariance follows from the variances of ``measured``, widened if the residual is larger.

    Raises ``IdentificationError`` for too few lines or a singular structure.
    """
    values = 2 * int((measured.weights() > 0).sum())
    unknowns = structure.columns + structure.shapes
    if values < 2 * unknowns:
        raise IdentificationError(
            f"{values} usable real values, {unknowns} parameters",
            needed="at least twice as many values as parameters",
            remedy="Measure more lines, or take fewer modes.",
        )
    # Start: the best of several trial delays, by vector fitting on some lines, refined on all.
    size, rate_Hz = len(measured.frequency_Hz), measured.sampling_rate_Hz
    scale = 2 * np.pi * measured.frequency_Hz[-1]
    s = 2j * np.pi * measured.frequency_Hz / scale
    flat, w = measured.response.reshape(size, 1), measured.weights().reshape(size, 1)
    declared = declaration.response(measured.frequency_Hz, rate_Hz)
    longest_s = declaration.longest_delay_s
    longest_s = 4.0 / rate_Hz if longest_s is None else longest_s
    initial_poles = start_poles(s[0].imag, 1.0, structure.modes, structure.lags)
    thinned = slice(None, None, -(-size // START_LINES))
    trials = []
    for delay_s in np.linspace(0.0, longest_s, min(round(longest_s * rate_Hz), 20) + 1):
        chain = (declared * np.exp(-s * scale * delay_s))[:, None]
        data = s[thinned], (flat / chain)[thinned], (w * np.abs(chain))[thinned]
        poles = vector_fit(*data, initial_poles, rounds=START_ROUNDS)
        trials.append((weighted_misfit(*data, poles), delay_s, poles))
    _, delay_s, poles = min(trials, key=lambda trial: trial[0])
    chain = (declared * np.exp(-s * scale * delay_s))[:, None]
    poles = vector_fit(s, flat / chain, w * np.abs(chain), poles, rounds=FINAL_ROUNDS)
    # Pairs of poles are modes; real poles are lags, and two of them a mode.
    poles_Hz = poles * scale / (2 * np.pi)
    pairs = list(poles_Hz[poles_Hz.imag > 0])
    real = sorted(np.abs(poles_Hz[poles_Hz.imag == 0].real))
    lags = [real.pop(0) for _ in range(structure.lags)]  # an odd number of poles has a real one
    modes = [(abs(p), -p.real / abs(p)) for p in pairs]
    modes += [
        (np.sqrt(a * b), (a + b) / (2 * np.sqrt(a * b)))
        for a, b in zip(real[::2], real[1::2], strict=False)
    ]
    modes = sorted(modes)[: structure.modes]
    damping = np.clip([z for _, z in modes], 1e-4, 10.0)
    start = [*np.log(np.concatenate([[f for f, _ in modes], damping, lags])), delay_s]

    basis = ModalBasis(
        structure=structure,
        frequency_Hz=measured.frequency_Hz,
        sampling_rate_Hz=measured.sampling_rate_Hz,
        declaration=declaration,
    )
    fit = _maximise_likelihood(measured, basis, np.array(start))
    return _linear_dynamics(measured, fit)[0]


def fit_with_slow_part(
    measured: FrequencyResponse, dynamics: LinearDynamics, slow: SlowPart
) -> tuple[LinearDynamics, SlowPart]:
    """Fit modes and slow part together, starting from separate fits.

        G = F e^(-j 2 pi f delay) (f / from)^power e^(j phase) [ modes + lags + D ]

    measured  of one axis, slow part included
    """
    basis = ModalBasis(
        structure=dynamics.structure,
        frequency_Hz=measured.frequency_Hz,
        sampling_rate_Hz=measured.sampling_rate_Hz,
        declaration=Declaration(hold=dynamics.hold, filters=dynamics.declared),
        creep_from_Hz=slow.from_Hz,
    )
    start = np.append(dynamics.shape, [slow.slope_dB / 20.0, np.radians(slow.phase_deg)])
    fit = _maximise_likelihood(measured, basis, start)
    refined, covariance = _linear_dynamics(measured, fit)
    power, phase = np.stack([fit.shape, np.sqrt(np.diag(covariance))], axis=1)[-2:]
    band_Hz = (slow.low_Hz, slow.high_Hz)
    part = SlowPart.of(20.0 * power, np.degrees(phase), band_Hz, slow.from_Hz)
    return refined, replace(part, is_taken=slow.is_taken)


def resolved_modes(dynamics: LinearDynamics) -> NDArray[np.bool_]:
    """Return whether the data determine each mode, (modes,).

    Other modes are overdamped or have wide intervals: they represent dynamics outside the band,
    and their parameters have no meaning of their own.
    """
    frequency = dynamics.mode_frequency_interval_Hz()
    damping = dynamics.mode_damping_interval()
    is_narrow = (frequency[:, 1] < 1.1 * frequency[:, 0]) & (damping[:, 1] < 3 * damping[:, 0])
    return np.asarray(is_narrow & (dynamics.mode_damping < 1.0), dtype=np.bool_)


def is_identifiable(dynamics: LinearDynamics) -> bool:
    """Return whether all modes are resolved and all lags lie within twice the band."""
    is_within = bool((dynamics.lag_frequency_Hz < 2.0 * dynamics.band_Hz[1]).all())
    return is_within and bool(resolved_modes(dynamics).all())


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalBasis:
    """Columns of the modal form at measured lines, which the gains multiply.

    structure         of the model
    frequency_Hz      (lines,)
    sampling_rate_Hz  of converter and sensor
    declaration       hold and declared filters between drive and sensor
    creep_from_Hz     frequency at which the slow part (f / from)^power e^(j phase), a factor of
                      all columns, has gain one; None: no slow part

    A shape is log frequencies of modes, log dampings, log frequencies of lags, delay; then power
    and phase of the slow part.
    """

    structure: Structure
    frequency_Hz: Array
    sampling_rate_Hz: float
    declaration: Declaration
    creep_from_Hz: float | None = None

    @property
    def shapes(self) -> int:
        """Number of shape parameters, including the slow part."""
        return self.structure.shapes + (0 if self.creep_from_Hz is None else 2)

    def columns(self, shape: Array) -> ComplexArray:
        """Return all columns, (lines, columns)."""
        values = np.empty((len(self.frequency_Hz), self.structure.columns), dtype=np.complex128)
        for column, parameters in enumerate(self._terms()):
            values[:, column] = self._term(shape[None], parameters)[0]
        return values * self._creep(shape)[:, None]

    def derivatives(self, shape: Array) -> ComplexArray:
        """Return derivatives by each shape parameter, (shapes, lines, columns).

        Central differences of width ``STEP``; of power and phase exact.
        """
        n, delay = len(shape), self.structure.shapes - 1
        derivatives = np.zeros(
            (n, len(self.frequency_Hz), self.structure.columns), dtype=np.complex128
        )
        for column, parameters in enumerate(self._terms()):
            indices = [*parameters, delay]
            steps = np.zeros((len(indices), n))
            steps[range(len(indices)), indices] = STEP
            steps[-1, delay] /= self.sampling_rate_Hz
            shapes = np.concatenate([shape + steps, shape - steps])
            shapes[:, delay] = np.maximum(shapes[:, delay], 0.0)  # one-sided at delay zero
            width = (shapes[: len(steps)] - shapes[len(steps) :]).sum(axis=1)
            up, down = np.split(self._term(shapes, parameters), 2)
            derivatives[indices, :, column] = (up - down) / width[:, None]
        derivatives *= self._creep(shape)[:, None]
        if self.creep_from_Hz is not None:
            columns = self.columns(shape)
            derivatives[-2] = np.log(self.frequency_Hz / self.creep_from_Hz)[:, None] * columns
            derivatives[-1] = 1j * columns
        return derivatives

    def _creep(self, shape: Array) -> ComplexArray:
        if self.creep_from_Hz is None:
            return np.ones(len(self.frequency_Hz), dtype=np.complex128)
        power, phase = shape[-2:]
        gain = (self.frequency_Hz / self.creep_from_Hz) ** power
        return np.asarray(gain * np.exp(1j * phase))

    def _terms(self) -> list[list[int]]:
        """Return the indices of the shape parameters of each column, without the delay."""
        n, lags = self.structure.modes, self.structure.lags
        modes = [[m, n + m] for m in range(n)]
        return [*modes, *([2 * n + k] for k in range(lags)), *([[]] * self.structure.direct)]

    def _term(self, shapes: Array, parameters: list[int]) -> ComplexArray:
        """Return the column of one term for several shapes, (shapes, lines)."""
        values, delay_s = np.exp(shapes[:, parameters]), shapes[:, self.structure.shapes - 1]
        w = 2.0 * np.pi * values[:, 0] if parameters else np.ones(len(shapes))
        numerator, pole = np.ones(len(shapes)), np.zeros((len(shapes), 0), dtype=complex)
        if len(parameters) == 2:
            damping = values[:, 1]
            root = np.sqrt(damping**2 - 1.0 + 0j)
            numerator, pole = w**2, (w * np.array([-damping + root, -damping - root])).T
        elif parameters:
            numerator, pole = w, -w[:, None].astype(complex)
        if self.declaration.hold == "zero_order":
            poles = self._declared_poles
            numerator = numerator * np.prod(-poles).real
            pole = np.hstack([pole, np.broadcast_to(poles, (len(shapes), len(poles)))])
            return sampled_fractions(
                numerator, pole, delay_s, self.sampling_rate_Hz, self.frequency_Hz
            )
        s = 2j * np.pi * self.frequency_Hz
        factor = self._declared_response * np.exp(-s * delay_s[:, None])
        for pole_of_shape in pole.T:
            factor /= s - pole_of_shape[:, None]
        return np.asarray(numerator[:, None] * factor)

    @cached_property
    def _declared_poles(self) -> ComplexArray:
        poles = [np.linalg.eigvals(f.system().A).astype(complex) for f in self.declaration.filters]
        return np.concatenate([np.zeros(0, dtype=complex), *poles])

    @cached_property
    def _declared_response(self) -> ComplexArray:
        return self.declaration.response(self.frequency_Hz, self.sampling_rate_Hz)


class _Point:
    """A shape with its optimal gains and their residual."""

    def __init__(self, measured: FrequencyResponse, basis: ModalBasis, shape: Array) -> None:
        response, weight = measured.response, measured.weights()
        self.basis, self.shape, self.weight = basis, shape, weight
        columns = basis.columns(shape)
        try:
            self.path = eliminate(
                stack_parts(columns * weight[:, None]),
                stack_parts((response * weight)[:, None])[:, 0],
            )
        except np.linalg.LinAlgError as error:
            raise IdentificationError(
                f"the modal form is singular: {error}",
                needed="more measured values than gains, and no two terms alike",
                remedy="Take fewer modes, leave out the direct term, or measure more lines.",
            ) from error
        self.cost = float(self.path.residual @ self.path.residual)

    def projected(self) -> tuple[Array, Array, Array]:
        """Return curvature, scores of each line, (lines, shapes), and d gains / d shape.

        The sum of the scores is the negative slope of half the cost, with the gains eliminated.
        """
        derivatives = self.basis.derivatives(self.shape)
        weighted = stack_parts((derivatives @ self.path.coefficients).T * self.weight[:, None])
        tangent, gain_slope = self.path.across(weighted)
        scores = (tangent * self.path.residual[:, None]).reshape(2, len(self.weight), -1)
        return tangent.T @ tangent, scores.sum(axis=0), gain_slope

    def linearised(self) -> NormalEquations:
        """Return the normal equations of the shape, with the gains eliminated."""
        curvature, scores, _ = self.projected()
        return NormalEquations(gram=curvature, slope=-scores.sum(axis=0), cost=self.cost)


def _maximise_likelihood(measured: FrequencyResponse, basis: ModalBasis, shape: Array) -> _Point:
    """Minimise sum |weight (response - columns(shape) gains)|^2 over shape and gains.

    A term beyond the bounds looks constant to the data, or like a single line. Delays are causal
    and at most as long as the slowest measured period.
    """
    n, lags = basis.structure.modes, basis.structure.lags
    lowest, highest = basis.frequency_Hz[[0, -1]]
    log_f = np.log([lowest / OUT_OF_BAND, highest * OUT_OF_BAND])
    counts = [n, n, lags, 1, basis.shapes - basis.structure.shapes]
    low = np.repeat([log_f[0], np.log(MIN_DAMPING), log_f[0], 0.0, -np.inf], counts)
    high = np.repeat([log_f[1], np.log(OUT_OF_BAND), log_f[1], 1 / lowest, np.inf], counts)
    longest = np.full(len(low), MAX_LOG_STEP)
    longest[basis.structure.shapes - 1] = 1 / lowest / 10
    return minimise(
        lambda shape: _Point(measured, basis, shape),
        shape,
        (low, high),
        rule=RULE,
        longest=longest,
    ).point


def _linear_dynamics(measured: FrequencyResponse, fit: _Point) -> tuple[LinearDynamics, Array]:
    """Return the fitted dynamics and the covariance of the whole shape.

    The variance of each parameter is the larger of inverse curvature and sandwich over lines. The
    factors 0.5 follow from complex values of variance one, whose parts have variance one half.
    """
    basis, structure, gains = fit.basis, fit.basis.structure, fit.path.coefficients
    curvature, scores, gain_slope = fit.projected()
    lines = int((fit.weight > 0).sum())
    spare = max(lines - (basis.shapes + structure.columns) / 2, 1.0)
    excess = max(1.0, fit.cost / spare)
    covariance = sandwich_covariance(curvature, [scores.T @ scores * lines / spare], 0.5 * excess)
    by_shape = gain_slope.sum(axis=0)
    static_variance = 0.5 * excess * float(np.sum(fit.path.root.sum(axis=0) ** 2))
    static_variance += float(by_shape @ covariance @ by_shape)
    n = structure.shapes
    # Complex values minus half the real unknowns, times the mean of 1 / (estimated variance).
    freedom = measured.variance_freedom
    inflation = freedom / (freedom - 1.0) if freedom > 2.0 else 2.0
    expected_cost = (lines - (structure.columns + basis.shapes) / 2) * inflation
    dynamics = LinearDynamics(
        axis=measured.axis,
        **sorted_terms(structure, fit.shape[:n], gains, covariance[:n, :n]),
        direct_gain_m_per_V=float(gains[-1]) if structure.direct else 0.0,
        declared=basis.declaration.filters,
        static_gain_std_m_per_V=float(np.sqrt(max(static_variance, 0.0))),
        hold=basis.declaration.hold,
        sampling_rate_Hz=measured.sampling_rate_Hz,
        band_Hz=(float(measured.frequency_Hz[0]), float(measured.frequency_Hz[-1])),
        drive_rms_V=measured.drive_rms_V,
        cost=fit.cost,
        expected_cost=float(expected_cost),
    )
    return dynamics, covariance


def sorted_terms(
    structure: Structure, shape: Array, gains: Array, covariance: Array
) -> dict[str, Any]:
    """Return shape and gains as fields of ``LinearDynamics``, modes and lags by frequency.

    shape, covariance  in the order of ``ModalBasis``, without a slow part
    gains              of modes, then lags, m/V; further gains are ignored
    """
    n, lags = structure.modes, structure.lags
    order = np.argsort(shape[:n])
    lag_order = np.argsort(shape[2 * n : 2 * n + lags])
    by_frequency = np.concatenate([order, n + order, 2 * n + lag_order, [2 * n + lags]])
    values = np.exp(shape[by_frequency])
    return {
        "mode_frequency_Hz": values[:n],
        "mode_damping": values[n : 2 * n],
        "mode_gain_m_per_V": gains[:n][order],
        "lag_frequency_Hz": values[2 * n : 2 * n + lags],
        "lag_gain_m_per_V": gains[n : n + lags][lag_order],
        "delay_s": float(shape[-1]),
        "shape_covariance": covariance[np.ix_(by_frequency, by_frequency)],
    }
