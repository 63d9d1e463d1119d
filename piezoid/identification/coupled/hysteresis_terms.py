"""What hysteresis and electrostriction add to a drive: plays and powers of drive and elongation.

    F_ik:  P_r(s_i), P_r(u_i) for thresholds r,   s^2, u^2, s u,   s^3, u^3, s^2 u, s u^2,
    each less its regression on u_i and s_i

P_r is the play of half-width r [Kuhnen 2003]; u is the drive of an actuator and s its elongation
in volts, both over their rms at the largest level, so that coefficients compare. What of a term
is linear belongs to the response behind it: left in, drive and response could grow and shrink
against each other without end.
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns

# Half-widths over the rms of their signal: from the smallest that 25 samples in a period of the
# fastest mode resolve to where a Gaussian signal of that rms hardly ever goes.
THRESHOLDS = np.array([0.01, 0.03, 0.08, 0.2, 0.4, 0.8, 1.4, 2.2])
POWERS = 7
TERMS = 2 * len(THRESHOLDS) + POWERS
OVERSAMPLING = 4  # between samples a play turns; at 2.5 samples a period it would miss the tips


def hysteresis_terms(drive: Array, elongation: Array, *, periodic: bool) -> Array:
    """Return the terms of one actuator.

    drive       (samples,)  u over its rms
    elongation  (samples,)  s over its rms
    periodic    go through the period once before, so that the memory is that of the steady state;
                otherwise the memory is empty at the first sample
    returned    (samples, TERMS)
    """
    u, s = drive, elongation
    powers = np.stack([s**2, u**2, s * u, s**3, u**3, s**2 * u, s * u**2], axis=1)
    parts = [plays(one, THRESHOLDS, periodic=periodic) for one in (s, u)]
    return np.concatenate([*parts, powers], axis=1)


def linear_share(terms: Array, drive: Array, elongation: Array) -> Array:
    """Return the regression of terms on drive and elongation, (2, terms).

    terms              (rows, terms)
    drive, elongation  (rows,)
    """
    both = np.stack([drive, elongation], axis=1)
    return np.asarray(np.linalg.lstsq(both, terms, rcond=None)[0])


def plays(signal: Array, half_width: Array, *, periodic: bool) -> Array:
    """Return plays of a signal, (samples, half-widths), settled where it is periodic."""
    memory = np.zeros(len(half_width))
    x = np.ascontiguousarray(signal)
    if periodic:
        _, memory = play_columns(x, half_width, memory)
    return play_columns(x, half_width, memory)[0]


def oversampled(spectrum: np.ndarray, samples: int) -> Array:
    """Return a signal at ``OVERSAMPLING`` times the rate of its lines, without others.

    spectrum  (samples // 2 + 1, ...)  of ``numpy.fft.rfft`` at ``samples``
    """
    fine = np.zeros((OVERSAMPLING * samples // 2 + 1, *spectrum.shape[1:]), dtype=np.complex128)
    fine[: len(spectrum)] = OVERSAMPLING * spectrum
    return np.asarray(np.fft.irfft(fine, OVERSAMPLING * samples, axis=0))


def at_lines(signal: Array, lines: np.ndarray) -> np.ndarray:
    """Return the lines, as of ``numpy.fft.rfft`` at the recorded rate, of oversampled signals."""
    return np.asarray(np.fft.rfft(signal, axis=0)[lines] / OVERSAMPLING)
