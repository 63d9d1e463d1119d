"""Modes, delay and slow part of a measured response fitted together, with what is known of each.

    G(f) = F(f) e^(-j 2 pi f delay) (j f / f1)^(-alpha) e^(j phase) [ modes + lags + D ]

A slow part that is found first and taken out would lend its own error to the delay without a word:
a thousandth of a radian is 0.16 us at 1 kHz. Here it is a parameter among the others.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.records import SlowPart
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.robust import NORMAL_95

STEP = 1e-6  # of central differences, of numbers that are all about one
MOST_STEPS = 60


@dataclass(frozen=True, kw_only=True, eq=False)
class _Form:
    """Which number of a vector is what: logs of frequencies, dampings and lags, delay, gains."""

    dynamics: LinearDynamics
    slow: SlowPart
    frequency_Hz: Array
    chain: ComplexArray
    delay_scale_s: float
    gain_m_per_V: float

    @property
    def modes(self) -> int:
        return len(self.dynamics.mode_frequency_Hz)

    @property
    def lags(self) -> int:
        return len(self.dynamics.lag_frequency_Hz)

    @property
    def shapes(self) -> int:
        """Frequencies, dampings, lags and the delay, as in the covariance of the dynamics."""
        return 2 * self.modes + self.lags + 1

    @property
    def has_direct(self) -> bool:
        return bool(self.dynamics.direct_gain_m_per_V.any())

    def start(self) -> Array:
        """Return the vector of what was found before."""
        d = self.dynamics
        gains = [d.mode_gain_m_per_V[:, 0, 0], d.lag_gain_m_per_V[:, 0, 0]]
        gains += [d.direct_gain_m_per_V[0]] if self.has_direct else []
        slow = [self.slow.slope_dB / 20.0, float(np.radians(self.slow.phase_deg))]
        return np.concatenate(
            [
                np.log(np.concatenate([d.mode_frequency_Hz, d.mode_damping, d.lag_frequency_Hz])),
                [d.delay_s / self.delay_scale_s],
                np.concatenate(gains) / self.gain_m_per_V,
                slow,
            ]
        )

    def response(self, vector: Array) -> ComplexArray:
        """Return the whole response of a vector, (lines,) m/V."""
        n, m = self.modes, self.lags
        f = self.frequency_Hz
        mode_Hz, damping = np.exp(vector[:n]), np.exp(vector[n : 2 * n])
        lag_Hz = np.exp(vector[2 * n : 2 * n + m])
        delay_s = vector[self.shapes - 1] * self.delay_scale_s
        gains = vector[self.shapes :]
        x = f[:, None] / mode_Hz
        inner = (1.0 / (1.0 - x**2 + 2j * damping * x)) @ gains[:n]
        inner = inner + (1.0 / (1.0 + 1j * f[:, None] / lag_Hz)) @ gains[n : n + m]
        if self.has_direct:
            inner = inner + gains[n + m]
        slow = (f / self.slow.from_Hz) ** vector[-2] * np.exp(1j * vector[-1])
        late = np.exp(-2j * np.pi * f * delay_s)
        return np.asarray(self.gain_m_per_V * self.chain * late * slow * inner)


def refined(
    lines: FrequencyResponse, whole: ComplexArray, dynamics: LinearDynamics, slow: SlowPart
) -> tuple[LinearDynamics, SlowPart]:
    """Fit modes and slow part together from where they were found, and return both.

    lines     in use, with their variances; of one path
    whole     (lines,)  the measured response, slow part and all
    dynamics  found behind the slow part
    slow      as it was found alone
    """
    from scipy.optimize import least_squares

    chain = np.ones(len(lines.frequency_Hz), dtype=np.complex128)
    for known in dynamics.declared:
        chain = chain * known.system().response(lines.frequency_Hz)[:, 0, 0]
    form = _Form(
        dynamics=dynamics,
        slow=slow,
        frequency_Hz=lines.frequency_Hz,
        chain=chain,
        delay_scale_s=1.0 / (2.0 * np.pi * float(lines.frequency_Hz[-1])),
        gain_m_per_V=abs(float(dynamics.static_gain_m_per_V[0, 0])),
    )
    weight = 1.0 / np.sqrt(lines.variance[:, 0, 0])

    def left(vector: Array) -> Array:
        residual = weight * (whole - form.response(vector))
        return np.concatenate([residual.real, residual.imag])

    start = form.start()
    low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
    low[form.shapes - 1] = 0.0
    start[form.shapes - 1] = max(start[form.shapes - 1], STEP)
    found = least_squares(
        left, start, bounds=(low, high), x_scale="jac", max_nfev=MOST_STEPS, method="trf"
    ).x
    return _told(form, lines, found, *_covariance(left, found, len(whole)))


def _covariance(left: Callable[[Array], Array], vector: Array, lines: int) -> tuple[Array, float]:
    """Return the covariance of a vector, and the cost there.

    From the curvature, wider where more is left than the variances say, or where the lines' own
    scores scatter more: as in ``curvature.with_covariance``.
    """
    steps = STEP * np.eye(len(vector))
    slopes = np.stack(
        [(left(vector + e) - left(vector - e)) / (2.0 * STEP) for e in steps], axis=1
    )
    residual = left(vector)
    cost, spare = float(residual @ residual), max(lines - len(vector) / 2.0, 1.0)
    scale = np.maximum(np.linalg.norm(slopes, axis=0), np.finfo(np.float64).tiny)
    inverse = np.linalg.pinv((slopes / scale).T @ (slopes / scale), rcond=1e-14, hermitian=True)
    inverse /= np.outer(scale, scale)
    plain = 0.5 * max(1.0, cost / spare) * inverse
    scores = (slopes * residual[:, None]).reshape(2, lines, -1).sum(axis=0)
    sandwich = inverse @ (scores.T @ scores * lines / spare) @ inverse
    ratio = np.diag(sandwich) / np.maximum(np.diag(plain), np.finfo(np.float64).tiny)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(plain * np.outer(wider, wider)), cost


def _told(
    form: _Form, lines: FrequencyResponse, vector: Array, covariance: Array, cost: float
) -> tuple[LinearDynamics, SlowPart]:
    n, m, shapes = form.modes, form.lags, form.shapes
    gains = vector[shapes:] * form.gain_m_per_V
    units = np.ones(shapes)
    units[-1] = form.delay_scale_s
    at_rest = np.zeros(len(vector))
    at_rest[shapes : shapes + n + m + form.has_direct] = form.gain_m_per_V
    freedom = lines.variance_freedom
    dynamics = replace(
        form.dynamics,
        mode_frequency_Hz=np.exp(vector[:n]),
        mode_damping=np.exp(vector[n : 2 * n]),
        lag_frequency_Hz=np.exp(vector[2 * n : 2 * n + m]),
        delay_s=float(vector[shapes - 1] * form.delay_scale_s),
        mode_gain_m_per_V=gains[:n].reshape(n, 1, 1),
        lag_gain_m_per_V=gains[n : n + m].reshape(m, 1, 1),
        direct_gain_m_per_V=(gains[n + m] if form.has_direct else 0.0) * np.ones((1, 1)),
        shape_covariance=covariance[:shapes, :shapes] * np.outer(units, units),
        static_gain_std_m_per_V=np.full((1, 1), np.sqrt(at_rest @ covariance @ at_rest)),
        cost=cost,
        expected_cost=(len(lines.frequency_Hz) - len(vector) / 2.0) * freedom / (freedom - 1.0),
    )
    power_std, turn_std = np.sqrt(np.diag(covariance)[-2:])
    slope_dB, half_dB = 20.0 * float(vector[-2]), 20.0 * NORMAL_95 * float(power_std)
    phase_deg = float(np.degrees(vector[-1]))
    half_deg = NORMAL_95 * float(np.degrees(turn_std))
    slow = replace(
        form.slow,
        slope_dB=slope_dB,
        slope_ci95=(slope_dB - half_dB, slope_dB + half_dB),
        phase_deg=phase_deg,
        phase_ci95=(phase_deg - half_deg, phase_deg + half_deg),
    )
    return dynamics, slow
