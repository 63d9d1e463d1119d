"""Exact discretisations of the linear parts of a stage.

Signals are linear between samples (first-order hold). Filters are then exact at the samples for
any ratio of time constant to sampling interval.
"""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FLICKER_CORNERS_Hz = np.geomspace(
    0.01, 1e3, 11
)  # two per decade look like 1/f to better than 1 dB


def first_order(signal: Array, time_constant_s: float, rate_Hz: float, start: float) -> Array:
    """Pass a piecewise linear signal through ``1 / (1 + s T)``.

        y[k] = a y[k-1] + (1 - a - b) x[k] + b x[k-1],  a = exp(-h/T), b = T/h (1 - a) - a

    ``start`` is the output of the filter at the first sample. ``T = 0`` returns the signal.
    """
    if time_constant_s <= 0.0:
        return signal.copy()
    ratio = 1.0 / (time_constant_s * rate_Hz)
    pole = float(np.exp(-ratio))
    old = -float(np.expm1(-ratio)) / ratio - pole
    return _filter(np.array([1.0 - pole - old, old]), np.array([1.0, -pole]), signal, start)


def held_first_order(signal: Array, time_constant_s: float, rate_Hz: float) -> Array:
    """Pass a signal with zero-order hold through ``1 / (1 + s T)``.

    The output at sample k depends on the signal up to sample k - 1; the start is a steady state.
    """
    pole = float(np.exp(-1.0 / (time_constant_s * rate_Hz)))
    return _filter(np.array([0.0, 1.0 - pole]), np.array([1.0, -pole]), signal, float(signal[0]))


def second_order(signal: Array, frequency_Hz: float, damping: float, rate_Hz: float) -> Array:
    """Pass a piecewise linear signal through ``w^2 / (s^2 + 2 z w s + w^2)`` from a steady state.

    The state is advanced by the matrix exponential of the oscillator with a linear input.
    """
    from scipy.linalg import expm
    from scipy.signal import lfilter, ss2tf

    w = 2.0 * np.pi * frequency_Hz
    line = np.zeros((4, 4))
    line[:2, :2] = [[0.0, 1.0], [-w * w, -2.0 * damping * w]]
    line[1, 2] = w * w
    line[2, 3] = rate_Hz
    step = expm(line / rate_Hz)
    advance, now, slope = step[:2, :2], step[:2, 2:3], step[:2, 3:4]
    # x[k+1] = A x[k] + (now - slope) u[k] + slope u[k+1]; xi = x - slope u removes the look-ahead
    drive = now - slope + advance @ slope
    numerator, denominator = ss2tf(advance, drive, np.array([[1.0, 0.0]]), slope[:1])
    swing: Array = lfilter(numerator[0], denominator, signal - signal[0])
    return swing + float(signal[0])


def coloured_noise(
    samples: int,
    rate_Hz: float,
    bandwidth_Hz: float,
    flicker_share: float,
    rng: np.random.Generator,
) -> Array:
    """Return sampled noise of unit variance with aliasing and a 1/f component.

    Each component is a first-order (Ornstein-Uhlenbeck) process sampled exactly: an AR(1) sequence
    with pole ``exp(-2 pi f / rate)``, which includes the aliased spectrum above Nyquist.
    """
    noise = math.sqrt(1.0 - flicker_share) * _sampled_lag(samples, rate_Hz, bandwidth_Hz, rng)
    share = math.sqrt(flicker_share / len(FLICKER_CORNERS_Hz))
    for corner_Hz in FLICKER_CORNERS_Hz:
        noise = noise + share * _sampled_lag(samples, rate_Hz, float(corner_Hz), rng)
    return noise


def shifted(signal: Array, delay_s: float, rate_Hz: float) -> Array:
    """Return the signal delayed by any time; before its start it equals the first value."""
    index = np.arange(len(signal), dtype=np.float64)
    return np.interp(index - delay_s * rate_Hz, index, signal)


def _sampled_lag(
    samples: int, rate_Hz: float, corner_Hz: float, rng: np.random.Generator
) -> Array:
    pole = float(np.exp(-2.0 * np.pi * corner_Hz / rate_Hz))
    kicks = rng.standard_normal(samples) * np.sqrt(1.0 - pole * pole)
    start = float(rng.standard_normal())
    return _filter(np.array([1.0]), np.array([1.0, -pole]), kicks, start, force=True)


def _filter(
    numerator: Array, denominator: Array, signal: Array, start: float, *, force: bool = False
) -> Array:
    """Run a first-order difference equation with first output ``start``, unless ``force``."""
    from scipy.signal import lfilter

    if force:
        state = np.array([-denominator[1] * start])
        return cast(Array, lfilter(numerator, denominator, signal, zi=state)[0])
    old = float(numerator[1]) if len(numerator) > 1 else 0.0
    state = np.array([old * float(signal[0]) - denominator[1] * start])
    filtered = cast(Array, lfilter(numerator, denominator, signal[1:], zi=state)[0])
    return np.concatenate(([start], filtered))
