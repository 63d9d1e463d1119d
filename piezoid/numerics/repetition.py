"""Periodic signals: their period, and the equal cycles for a period of any length."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from piezoid.numerics.arrays import Array, runs_of

ALIKE = 0.8  # correlation of a drive with itself one period later, a ramp before it included
UNLIKE = 0.5  # the first fall below ends the drive's likeness to itself at once
TOLERANCE = 1e-3  # of the reach of a signal: by so much a repeated sample may differ
SETTLING = 1  # whole periods at the start of the repetition that do not count
FEWEST = 2  # periods after those, or noise cannot be seen
STILL = 1e-3  # of the drive's reach: an axis that moves less is not driven


@dataclass(frozen=True, kw_only=True)
class Repetition:
    """Where a drive repeats itself.

    first           sample at which the repetition begins
    period_samples  of one period
    periods         whole ones from there
    """

    first: int
    period_samples: int
    periods: int

    def last_periods(self, signal: Array, periods: int) -> Array:
        """Return the last periods of a signal side by side, (period_samples, periods)."""
        start = self.first + (self.periods - periods) * self.period_samples
        stop = start + periods * self.period_samples
        return np.asarray(signal[start:stop].reshape(periods, self.period_samples).T)


@dataclass(frozen=True, kw_only=True)
class EqualCycles:
    """Equal cycles of a drive whose period need not be a whole number of samples.

    first           sample at which the first begins
    period_samples  of one cycle, any number
    count           whole cycles from there
    """

    first: int
    period_samples: float
    count: int

    def cut(self, signal: Array) -> Array:
        """Return a signal cycle by cycle, straight between samples, (count, samples)."""
        within = np.arange(int(self.period_samples))
        starts = self.first + self.period_samples * np.arange(self.count)
        time = starts[:, None] + within
        return np.asarray(np.interp(time, np.arange(len(signal)), signal), dtype=np.float64)


def find_repetition(signal: Array, *, fewest: int = SETTLING + FEWEST) -> Repetition | None:
    """Return start and period of a periodic drive, or None.

    fewest  periods the drive must have room for

    The period is the first lag at which the steps of the drive correlate with themselves, after
    they once did not; then every sample must repeat. Rest and ramps at the ends do not matter.
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

    Few generators lock their period to the converter. One that is no whole number of samples is
    found by the phase of its first harmonic from cycle to cycle; samples between two are taken
    straight, which misses the corner of a triangle by less than a sample's step.
    """
    exact = find_repetition(signal, fewest=fewest)
    if exact is not None and exact.periods >= fewest:
        return EqualCycles(
            first=exact.first, period_samples=exact.period_samples, count=exact.periods
        )
    rounded, moving = _period(signal, fewest)
    if rounded is None:
        return None
    period = _fractional(signal[moving], float(rounded))
    sample = np.arange(moving.start, moving.stop - int(np.ceil(period)))
    later = np.interp(sample + period, np.arange(len(signal)), signal)
    tolerance = (TOLERANCE + 1.0 / period) * float(np.ptp(signal))
    first, stop = _longest_run(np.abs(later - signal[sample]) <= tolerance)
    cycles = EqualCycles(
        first=moving.start + first,
        period_samples=period,
        count=int((stop - first + period) // period),
    )
    return cycles if cycles.count >= fewest and _are_equal(cycles.cut(signal)) else None


def _period(signal: Array, fewest: int) -> tuple[int | None, slice]:
    """Return the period of the drive's steps, whole samples, and where the drive moves.

    It is the lag of the first peak of the correlation, each lag over the energies it compares.
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
    below = np.flatnonzero(correlation < UNLIKE)
    if not len(below):
        return None, rows
    above = below[0] + np.flatnonzero(correlation[below[0] :] >= ALIKE)
    if not len(above):
        return None, rows
    peak = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1)[0]
    return int(peak[np.argmax(correlation[peak])]), rows


def _longest_run(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the first and the stop of the longest run of flags that are set."""
    return max(runs_of(flags), key=lambda run: run[1] - run[0], default=(0, 0))


def _fractional(signal: Array, period: float) -> float:
    """Return the period for which the phase of the first harmonic is constant over cycles."""
    for _ in range(3):
        starts = np.arange(int((len(signal) - 1) // period)) * period
        time = starts[:, None] + np.arange(int(period))
        cycles = np.interp(time, np.arange(len(signal)), signal - signal.mean())
        harmonic = (cycles * np.exp(-2j * np.pi * time / period)).sum(axis=1)
        turned = float(np.median(np.angle(harmonic[1:] * harmonic[:-1].conj())))
        period = period / (1.0 + turned / (2.0 * np.pi))
    return period


def _are_equal(cycles: Array) -> bool:
    """Tell whether trend and scatter of the size of the cycles are within the tolerance.

    Of a triangle a cycle's size also depends on where its samples meet the corners.
    """
    mean = cycles.mean(axis=0)
    level = mean - mean.mean()
    size = cycles @ level / (level @ level)
    time = np.linspace(-0.5, 0.5, len(size))
    trend = float(time @ size / (time @ time))
    return abs(trend) <= TOLERANCE and float(np.ptp(size)) <= TOLERANCE + 1.0 / cycles.shape[1]
