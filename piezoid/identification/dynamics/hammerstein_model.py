"""The Hammerstein model and its derivatives: memory before dynamics, one vector of parameters.

    y = G(s) Psi( sum_i w_i z_i[u] ),        G(0) = 1
    G(s) = e^(-s tau) [ sum_m g_m w_m^2/(s^2 + 2 zeta_m w_m s + w_m^2) + sum_l g_l w_l/(s + w_l) ]

parameters: w_i | weights of the dead zones but the central one | ln f_m | ln zeta_m | ln f_l | tau
            | g but the last, which makes the sum 1

Every derivative is a signal behind the same G, or the same signal behind a derivative of G.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft

from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.hammerstein_rows import HammersteinRows
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii


@dataclass(frozen=True, kw_only=True)
class HammersteinShape:
    """How the vector of parameters is laid out.

    plays, zones, modes, lags  how many of each
    threshold_m                of the dead zones
    """

    plays: int
    zones: int
    modes: int
    lags: int
    threshold_m: Array

    @property
    def linear(self) -> slice:
        """Where ln f, ln zeta, ln f of lags and the delay stand, as in LinearDynamics."""
        first = self.plays + self.zones - 1
        return slice(first, first + 2 * self.modes + self.lags + 1)

    @property
    def size(self) -> int:
        """Number of parameters."""
        linear = self.plays + self.zones + 2 * self.modes + self.lags
        return linear + self.modes + self.lags - 1

    def split(self, theta: Array) -> tuple[Array, DeadZones, Array, Array]:
        """Return play weights, dead zones, the linear shape, and all shares."""
        zero = int(np.flatnonzero(self.threshold_m == 0.0)[0])
        weight = np.insert(theta[self.plays : self.linear.start], zero, 1.0)
        shares = theta[self.linear.stop :]
        return (
            theta[: self.plays],
            DeadZones(threshold=self.threshold_m, weight=weight),
            theta[self.linear],
            np.append(shares, 1.0 - shares.sum()),
        )


def start_of(
    operator: ModifiedPrandtlIshlinskii, dynamics: LinearDynamics, threshold_V: Array
) -> tuple[HammersteinShape, Array]:
    """Return layout and parameters of an operator and dynamics that were found apart.

    threshold_V  (plays,)  of the operator and others beside them, which begin without weight
    """
    place = np.searchsorted(threshold_V, operator.plays.threshold)
    weight = np.zeros(len(threshold_V))
    weight[place] = operator.plays.weight
    shape = HammersteinShape(
        plays=len(threshold_V),
        zones=len(operator.dead_zones.weight),
        modes=len(dynamics.mode_frequency_Hz),
        lags=len(dynamics.lag_frequency_Hz),
        threshold_m=operator.dead_zones.threshold,
    )
    gains = np.concatenate(
        [dynamics.mode_gain_m_per_V[:, 0, 0], dynamics.lag_gain_m_per_V[:, 0, 0]]
    )
    theta = np.concatenate(
        [
            weight,
            np.delete(operator.dead_zones.weight, operator.dead_zones.zero),
            np.log(dynamics.mode_frequency_Hz),
            np.log(dynamics.mode_damping),
            np.log(dynamics.lag_frequency_Hz),
            [dynamics.delay_s],
            (gains / gains.sum())[:-1],
        ]
    )
    return shape, theta


def terms_at(shape: HammersteinShape, linear: Array, frequency_Hz: Array) -> ComplexArray:
    """Return the modes and lags without their shares, the delay with them, (lines, terms)."""
    n, lags = shape.modes, shape.lags
    s = 2j * np.pi * frequency_Hz[:, None]
    w = 2.0 * np.pi * np.exp(linear[:n])
    zeta = np.exp(linear[n : 2 * n])
    low = 2.0 * np.pi * np.exp(linear[2 * n : 2 * n + lags])
    modes = w**2 / (s**2 + 2.0 * zeta * w * s + w**2)
    return np.asarray(np.concatenate([modes, low / (s + low)], axis=1) * np.exp(-s * linear[-1]))


def simulate_rows(shape: HammersteinShape, theta: Array, rows: HammersteinRows) -> Array:
    """Return the model's displacement, (samples,), about its first value."""
    weight, zones, linear, shares = shape.split(theta)
    moved = zones.run(weight @ rows.states_V)
    response = rows.chain * (terms_at(shape, linear, rows.frequency_Hz) @ shares)
    return _back(rows, response * rows.spectrum(moved))


def tangents(shape: HammersteinShape, theta: Array, rows: HammersteinRows) -> Array:
    """Return the derivatives of ``simulate_rows``, (parameters, samples)."""
    weight, zones, linear, shares = shape.split(theta)
    inner = weight @ rows.states_V
    moved, slope = zones.run_with_slope(inner)
    terms = terms_at(shape, linear, rows.frequency_Hz)
    response = rows.chain * (terms @ shares)
    spectrum = rows.chain * rows.spectrum(moved)
    outer = np.delete(zones.columns(inner).T, zones.zero, axis=0)
    inside = (*(slope * states for states in rows.states_V), *outer)
    changes = _changes(shape, linear, shares, terms, rows.frequency_Hz)
    changes += [terms[:, place] - terms[:, -1] for place in range(len(shares) - 1)]
    found = np.empty((shape.size, rows.samples))
    for place, signal in enumerate(inside):
        found[place] = _back(rows, response * rows.spectrum(signal))
    for place, change in enumerate(changes, start=len(inside)):
        found[place] = _back(rows, change * spectrum)
    return found


def _changes(
    shape: HammersteinShape,
    linear: Array,
    shares: Array,
    terms: ComplexArray,
    frequency_Hz: Array,
) -> list[ComplexArray]:
    """Derivatives of G by each entry of the linear shape: T = w^2/D, L = p/(s + p)."""
    n, lags = shape.modes, shape.lags
    s = 2j * np.pi * frequency_Hz
    late = np.exp(-s * linear[-1])
    found: list[ComplexArray] = []
    damped: list[ComplexArray] = []
    for m in range(n):
        w, zeta = 2.0 * np.pi * np.exp(linear[m]), np.exp(linear[n + m])
        below = s**2 + 2.0 * zeta * w * s + w**2
        along = shares[m] * terms[:, m]
        found.append(along * (2.0 - (2.0 * zeta * w * s + 2.0 * w**2) / below))
        damped.append(along * (-2.0 * zeta * w * s / below))
    found += damped
    for k in range(lags):
        low = 2.0 * np.pi * np.exp(linear[2 * n + k])
        found.append(shares[n + k] * late * low * s / (s + low) ** 2)
    found.append(-s * (terms @ shares))
    return found


def _back(rows: HammersteinRows, spectrum: ComplexArray) -> Array:
    return np.asarray(irfft(spectrum, rows.padded))[: rows.samples]
