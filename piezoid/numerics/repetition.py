"""Periodic signals: their period, and equal cycles of a fractional period."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from piezoid.numerics.arrays import Array, runs_of

# Smallest correlation of the steps of a drive with themselves one period later, which a ramp at
# the start lowers, and the correlation that ends the peak at lag 0.
MIN_CORRELATION, END_CORRELATION = 0.8, 0.5
TOLERANCE = 1e-3  # of the range of a signal: difference of repeated samples
SETTLING = 1  # whole periods at the start of the repetition that are not used
FEWEST = 2  # periods after those, for an estimate of the noise
STILL = 1e-3  # of the range of the drive: an axis that moves less is not driven


@dataclass(frozen=True, kw_only=True)
class Repetition:
    """Repeated part of a drive, with a period of whole samples.

    first           first sample of the repeated part
    period_samples  length of a period
    periods         number of whole periods
    """

    first: int
    period_samples: int
    periods: int

    def last_periods(self, signal: Array, periods: int) -> Array:
        """Return the last periods of a signal as columns, (period_samples, periods)."""
        start = self.first + (self.periods - periods) * self.period_samples
        stop = start + periods * self.period_samples
        return np.asarray(signal[start:stop].reshape(periods, self.period_samples).T)


@dataclass(frozen=True, kw_only=True)
class EqualCycles:
    """Equal cycles of a drive, with a period of any number of samples.

    first           first sample of the first cycle
    period_samples  length of a cycle
    count           number of whole cycles
    """

    first: int
    period_samples: float
    count: int

    def cut(self, signal: Array) -> Array:
        """Return the cycles of a signal, interpolated linearly, (count, samples)."""
        within = np.arange(int(self.period_samples))
        starts = self.first + self.period_samples * np.arange(self.count)
        time = starts[:, None] + within
        return np.asarray(np.interp(time, np.arange(len(signal)), signal), dtype=np.float64)


def find_repetition(signal: Array, *, fewest: int = SETTLING + FEWEST) -> Repetition | None:
    """Return start and period of a periodic drive, or None.

    fewest  smallest number of periods in the length of the drive

    The period is the lag of the first peak of the autocorrelation of the drive's steps behind its
    first fall; within it every sample must repeat. Rest and ramps at the ends do not matter.
    """
    period, _ = _period(signal, fewest)
    if period is None:
        return None
    tolerance = TOLERANCE * float(np.ptp(signal))
    first, stop = _longest_run(np.abs(signal[period:] - signal[:-period]) <= tolerance)
    periods = (stop - first + period) // period
    if periods < 2:
        return None
    return Repetition(first=first, period_samples=period, periods=periods)


def equal_cycles(signal: Array, *, fewest: int) -> EqualCycles | None:
    """Return the equal cycles of a drive; None if there are fewer than ``fewest``.

    Few generators lock their period to the converter. A fractional period is found from the phase
    of the first harmonic from cycle to cycle. The drive is interpolated linearly, with an error
    below one step at the corner of a triangle.
    """
    exact = find_repetition(signal, fewest=fewest)
    if exact is not None and exact.periods >= fewest:
        return EqualCycles(
            first=exact.first, period_samples=exact.period_samples, count=exact.periods
        )
    rounded, moving = _period(signal, fewest)
    if rounded is None:
        return None
    # The period for which the phase of the first harmonic is constant over the cycles.
    period, level = float(rounded), signal[moving] - signal[moving].mean()
    for _ in range(3):
        starts = np.arange(int((len(level) - 1) // period)) * period
        time = starts[:, None] + np.arange(int(period))
        harmonic = np.interp(time, np.arange(len(level)), level)
        harmonic = (harmonic * np.exp(-2j * np.pi * time / period)).sum(axis=1)
        turned = float(np.median(np.angle(harmonic[1:] * harmonic[:-1].conj())))
        period = period / (1.0 + turned / (2.0 * np.pi))
    sample = np.arange(moving.start, moving.stop - int(np.ceil(period)))
    later = np.interp(sample + period, np.arange(len(signal)), signal)
    tolerance = (TOLERANCE + 1.0 / period) * float(np.ptp(signal))
    first, stop = _longest_run(np.abs(later - signal[sample]) <= tolerance)
    cycles = EqualCycles(
        first=moving.start + first,
        period_samples=period,
        count=int((stop - first + period) // period),
    )
    if cycles.count < fewest:
        return None
    # Trend and scatter of the size of the cycles must be within the tolerance. The size of a
    # sampled triangle also depends on the position of the samples at its corners.
    pieces = cycles.cut(signal)
    mean = pieces.mean(axis=0)
    level = mean - mean.mean()
    size = pieces @ level / (level @ level)
    time = np.linspace(-0.5, 0.5, len(size))
    trend = float(time @ size / (time @ time))
    is_equal = abs(trend) <= TOLERANCE and np.ptp(size) <= TOLERANCE + 1.0 / pieces.shape[1]
    return cycles if is_equal else None


def _period(signal: Array, fewest: int) -> tuple[int | None, slice]:
    """Return the period of the drive's steps, in whole samples, and the moving part of the drive.

    The period is the lag of the first peak of the correlation, normalised at each lag.
    """
    steps = np.diff(signal)
    moving = np.flatnonzero(np.abs(steps) > TOLERANCE * np.abs(steps).max(initial=0.0))
    if not len(moving):
        return None, slice(0)
    steps = steps[moving[0] : moving[-1] + 1]
    rows, count = slice(int(moving[0]), int(moving[-1]) + 2), len(steps)
    padded = next_fast_len(2 * count, real=True)
    common = irfft(np.abs(rfft(steps, padded)) ** 2, padded)[: (count + 1) // fewest + 1]
    energy = np.concatenate([[0.0], np.cumsum(steps**2)])
    lag = np.arange(len(common))
    scale = np.sqrt(energy[count - lag] * (energy[-1] - energy[lag]))
    correlation = common / np.maximum(scale, 1e-12 * energy[-1] + np.finfo(float).tiny)
    below = np.flatnonzero(correlation < END_CORRELATION)
    if not len(below):
        return None, rows
    above = below[0] + np.flatnonzero(correlation[below[0] :] >= MIN_CORRELATION)
    if not len(above):
        return None, rows
    peak = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1)[0]
    return int(peak[np.argmax(correlation[peak])]), rows


def _longest_run(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Return first and stop of the longest run of true flags."""
    return max(runs_of(flags), key=lambda run: run[1] - run[0], default=(0, 0))
