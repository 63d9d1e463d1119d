"""Nonlinear distortion of a coupled stage: plays and products of all drives in every mode.

    Y = e^(-s delay) [ G(s, l) U + sum_t sum_c b_c(s, l) W_ct F_t(u, e) ]

G is the linear model of ``piezoid.fit_coupled`` and b_c are its columns (modes, lags, direct).
F_t are plays and products of the drives u and of the elongations e = B G u, where B is the inverse
of the gain at low frequency. The drives themselves are terms that correct the residues of G. W is
linear, and ridge regression of the residual determines it for fixed poles.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.linalg import cho_factor, cho_solve

import piezoid

OVERSAMPLING = 4  # at 2.5 samples per period a play would miss the turning points
# Half-widths of plays of the drive, of the elongation, and of the drive with and against half the
# elongation, each over the rms of its signal at the largest level.
DRIVE_WIDTHS = (0.02, 0.06, 0.15, 0.4, 1.0)
ELONGATION_WIDTHS = (0.03, 0.12, 0.4, 1.2)
SUM_WIDTHS = (0.05, 0.2, 0.7)
# Over the curvature of each coefficient. With 1e-3 and 3e-3 the errors of the first realisation
# are 3.72 and 3.78 % at 100 mV, 2.37 and 2.34 % at 300 mV.
RIDGE = 2e-3
FREE = 1e-9  # ridge of the terms that correct the residues of the linear part


@dataclass(frozen=True, kw_only=True, eq=False)
class DistortedStage:
    """A coupled stage with nonlinear distortion.

    linear   the linear part
    scale_V  (2, inputs)  rms of drives and elongations at the largest level
    weight   (columns, terms, outputs)  W, m
    """

    linear: piezoid.CoupledStage
    scale_V: np.ndarray
    weight: np.ndarray

    def simulate(self, drive_V: np.ndarray) -> np.ndarray:
        """Return the steady response to a period, without mean, (samples, outputs), m."""
        linear_m = self.linear.simulate(drive_V, periodic=True)
        return linear_m + self.distortion(drive_V[:, :, None])[:, :, 0]

    def distortion(self, drive_V: np.ndarray) -> np.ndarray:
        """Return the distortion of periods in steady state, (samples, outputs, realisations), m.

        drive_V  (samples, inputs, realisations)
        """
        samples = len(drive_V)
        lines = np.arange(1, samples // 2 + 1)
        f = lines * self.linear.sampling_rate_Hz / samples
        inside = (f >= 0.5 * self.linear.band_Hz[0]) & (f <= self.linear.band_Hz[1])
        level_V = float(drive_V.std())
        columns = _columns(self.linear, f[inside], level_V)
        terms = _terms(self.linear, drive_V, self.scale_V, level_V)[lines[inside]]
        spectrum = np.zeros((samples // 2 + 1, *self.weight.shape[2:], drive_V.shape[2]), complex)
        delay = np.exp(-2j * np.pi * f[inside] * self.linear.delay_s)[:, None, None]
        response = np.einsum("fc,ftr,cto->for", columns, terms, self.weight, optimize=True)
        spectrum[lines[inside]] = delay * response
        return np.fft.irfft(spectrum, samples, axis=0)


def fit_distorted(levels: Sequence[piezoid.PeriodicData], modes: int) -> DistortedStage:
    """Fit the linear part, then the distortion to its residual, to the means of the periods.

    The ridge regression weights each realisation by the inverse power of its residual.
    """
    linear = piezoid.fit_coupled(levels, modes=modes, intervals=False)
    levels = sorted(levels, key=lambda level: float(level.voltage_V.std()))
    largest_V = float(levels[-1].voltage_V.std())
    signals = _signals(linear, levels[-1].voltage_V.mean(axis=3), largest_V)
    scale_V = np.stack([signal.std(axis=(0, 2)) for signal in signals])
    gram, target = np.zeros(()), np.zeros(())
    for level in levels:
        drive_V, lines = level.voltage_V.mean(axis=3), level.excited_lines()
        f, level_V = level.frequency_Hz(lines), float(level.voltage_V.std())
        residual = _residual_lines(linear, level, lines, level_V)
        columns = _columns(linear, f, level_V)
        weight = 1.0 / np.sqrt((np.abs(residual) ** 2).sum(axis=(0, 1)))
        terms = _terms(linear, drive_V, scale_V, level_V)[lines] * weight
        gram = gram + _gram(columns, terms)
        products = (residual * weight) @ terms.conj().transpose(0, 2, 1)  # (lines, outputs, terms)
        flat = (columns.conj().T @ products.reshape(len(lines), -1)).real
        count = len(products[0])
        target = target + flat.reshape(-1, count, terms.shape[1]).transpose(0, 2, 1).reshape(
            -1, count
        )
    shape = (columns.shape[1], terms.shape[1], target.shape[1])
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-12 * np.diag(gram).max()))
    ridge = np.full(shape[:2], RIDGE)
    ridge[:, -2 * len(scale_V[0]) :] = FREE
    stiff = gram / np.outer(scale, scale) + np.diag(ridge.ravel())
    weights = cho_solve(cho_factor(stiff), target / scale[:, None]) / scale[:, None]
    return DistortedStage(linear=linear, scale_V=scale_V, weight=weights.reshape(shape))


def _residual_lines(
    linear: piezoid.CoupledStage,
    level: piezoid.PeriodicData,
    lines: np.ndarray,
    level_V: float,
) -> np.ndarray:
    """Return the residual of the linear part without delay, (lines, outputs, realisations)."""
    f = level.frequency_Hz(lines)
    drive, response = (
        np.fft.rfft(signal.mean(axis=3), axis=0)[lines]
        for signal in (level.voltage_V, level.displacement_m)
    )
    residual = response - linear.response(f, level_V) @ drive
    return residual * np.exp(2j * np.pi * f * linear.delay_s)[:, None, None]


def _columns(linear: piezoid.CoupledStage, f: np.ndarray, level_V: float) -> np.ndarray:
    """Return the columns of the residues of the linear part, (lines, columns).

    h = w / (s - p),  (h + h~) / 2,  j (h - h~) / 2,  w_l / (s + w_l),  1
    """
    s = 2j * np.pi * f[:, None]
    w, zeta = 2.0 * np.pi * linear.mode_frequency_Hz(level_V), linear.mode_damping(level_V)
    pole = w * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    h, conjugate = w / (s - pole), w / (s - pole.conj())
    lag = 2.0 * np.pi * linear.lag_Hz
    parts = [(h + conjugate) / 2, 0.5j * (h - conjugate), lag / (s + lag), np.ones_like(s)]
    return np.concatenate(parts, axis=1)


def _signals(
    linear: piezoid.CoupledStage, drive_V: np.ndarray, level_V: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return oversampled drives and elongations, (fine samples, inputs, realisations), V."""
    samples = len(drive_V)
    spectrum = np.fft.rfft(drive_V, axis=0)
    f = np.arange(len(spectrum)) * linear.sampling_rate_Hz / samples
    spectrum[(f < 0.5 * linear.band_Hz[0]) | (f > linear.band_Hz[1])] = 0.0
    delay = np.exp(2j * np.pi * f * linear.delay_s)[:, None, None]
    elongation = np.linalg.pinv(linear.coupling_m_per_V)
    elongations = elongation @ (delay * linear.response(f, level_V) @ spectrum)
    return _oversampled(spectrum, samples), _oversampled(elongations, samples)


def _terms(
    linear: piezoid.CoupledStage, drive_V: np.ndarray, scale_V: np.ndarray, level_V: float
) -> np.ndarray:
    """Return the spectra of the terms F, (samples // 2 + 1, terms, realisations)."""
    u, e = (
        signal / scale[:, None]
        for signal, scale in zip(_signals(linear, drive_V, level_V), scale_V, strict=True)
    )
    inputs, played, widths, products = u.shape[1], [], [], []
    for i in range(inputs):
        a, b = u[:, i], e[:, i]
        for signal, half_widths in (
            *((a, DRIVE_WIDTHS), (b, ELONGATION_WIDTHS)),
            *((a - 0.5 * b, SUM_WIDTHS), (a + 0.5 * b, SUM_WIDTHS)),
        ):
            played += [signal] * len(half_widths)
            widths += half_widths
        products += [a**3, a**2 * b, a * b**2]
    both_signals = np.concatenate([e, u], axis=1)
    for signals, order in ((both_signals, 2), (e, 3)):
        for indices in combinations_with_replacement(range(signals.shape[1]), order):
            products.append(signals[:, list(indices)].prod(axis=1))
    plays = _plays(np.stack(played, axis=1), np.array(widths))
    linear_terms = [u, linear.coordinate(level_V) * u]
    terms = np.concatenate([plays, np.stack(products, axis=1), *linear_terms], axis=1)
    return np.fft.rfft(terms, axis=0)[: len(drive_V) // 2 + 1] / OVERSAMPLING


def _plays(signal: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    """Return the plays of periodic signals after one period, (samples, plays, realisations)."""
    low, high = signal - half_width[:, None], signal + half_width[:, None]
    state, states = np.zeros(signal.shape[1:]), np.empty_like(signal)
    for _ in range(2):
        for k in range(len(signal)):
            np.minimum(high[k], state, out=state)
            np.maximum(low[k], state, out=state)
            states[k] = state
    return states


def _oversampled(spectrum: np.ndarray, samples: int) -> np.ndarray:
    """Return a signal with ``OVERSAMPLING`` times its sampling rate."""
    fine = np.zeros((OVERSAMPLING * samples // 2 + 1, *spectrum.shape[1:]), dtype=complex)
    fine[: len(spectrum)] = OVERSAMPLING * spectrum
    return np.fft.irfft(fine, OVERSAMPLING * samples, axis=0)


def _gram(columns: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Return A'A of the rows b_c F_t without computing A, (columns * terms, columns * terms).

    (A'A)_(ct, du) = sum_f Re( conj(b_c) b_d sum_r conj(F_t) F_u )
    """
    count, n = columns.shape[1], terms.shape[1]
    power = terms.conj() @ terms.transpose(0, 2, 1)
    gram = np.empty((count, n, count, n))
    for t in range(n):
        for u in range(t + 1):
            block = ((columns.conj() * power[:, t, u, None]).T @ columns).real
            gram[:, t, :, u], gram[:, u, :, t] = block, block.T
    return gram.reshape(count * n, count * n)
