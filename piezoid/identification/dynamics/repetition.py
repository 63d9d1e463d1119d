"""Recordings of a periodic drive: their period is found in the drive, and they are cut at it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from piezoid.identification.dynamics.periodic_estimate import PeriodicData
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity, Recording

ALIKE = 0.8  # correlation of a drive with itself one period later, a ramp before it included
APART = 0.5  # the first fall below ends the drive's likeness to itself at once
SAME = 1e-3  # of the drive's reach: by so much a repeated sample may differ
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
        begins = self.first + self.period_samples * np.arange(self.count)
        time = begins[:, None] + within
        return np.asarray(np.interp(time, np.arange(len(signal)), signal), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class PeriodicRecordings:
    """Recordings of one axis that differ in nothing but the phases of their drive.

    names  of the recordings, one realisation each
    data   their steady periods, drift that is straight over the record taken out
    """

    names: tuple[str, ...]
    data: PeriodicData


def find_repetition(voltage_V: Array, *, fewest: int = SETTLING + FEWEST) -> Repetition | None:
    """Return where and how a drive repeats, or None.

    fewest  periods the drive must have room for

    The period is the first lag at which the steps of the drive correlate with themselves, after
    they once did not; then every sample must repeat. Rest and ramps at the ends do not matter.
    """
    steps = np.diff(voltage_V)
    moving = np.flatnonzero(np.abs(steps) > SAME * np.abs(steps).max(initial=0.0))
    period = _period(steps[moving[0] : moving[-1] + 1], fewest) if len(moving) else None
    if period is None:
        return None
    reach_V = float(np.ptp(voltage_V))
    again = np.abs(voltage_V[period:] - voltage_V[:-period]) <= SAME * reach_V
    edges = np.flatnonzero(np.diff(np.concatenate([[False], again, [False]]).astype(np.int8)))
    runs = list(zip(edges[::2], edges[1::2], strict=True))
    first, after = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    periods = int(after - first + period) // period
    return (
        None
        if periods < 2
        else Repetition(first=int(first), period_samples=period, periods=periods)
    )


def equal_cycles(voltage_V: Array, *, fewest: int) -> EqualCycles | None:
    """Return the equal cycles of a drive, or None where there are fewer than asked for.

    Few generators lock their period to the converter. One that is no whole number of samples is
    found by the phase of its first harmonic from cycle to cycle; samples between two are taken
    straight, which misses the corner of a triangle by less than a sample's step.
    """
    exact = find_repetition(voltage_V, fewest=fewest)
    if exact is not None and exact.periods >= fewest:
        return EqualCycles(
            first=exact.first, period_samples=exact.period_samples, count=exact.periods
        )
    steps = np.diff(voltage_V)
    moving = np.flatnonzero(np.abs(steps) > SAME * np.abs(steps).max(initial=0.0))
    whole = _period(steps[moving[0] : moving[-1] + 1], fewest) if len(moving) else None
    if whole is None:
        return None
    begin, end, reach_V = int(moving[0]), int(moving[-1]) + 2, float(np.ptp(voltage_V))
    period = _fractional(voltage_V[begin:end], float(whole))
    place = np.arange(begin, end - int(np.ceil(period)))
    later = np.interp(place + period, np.arange(len(voltage_V)), voltage_V)
    again = np.abs(later - voltage_V[place]) <= (SAME + 1.0 / period) * reach_V
    edges = np.flatnonzero(np.diff(np.concatenate([[False], again, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2], strict=True)
    first, after = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    count = int((after - first + period) // period)
    found = EqualCycles(first=begin + int(first), period_samples=period, count=count)
    return found if count >= fewest and _are_equal(found.cut(voltage_V)) else None


def _fractional(signal: Array, period: float) -> float:
    """Return the period by which the first harmonic's phase stands from cycle to cycle."""
    for _ in range(3):
        begins = np.arange(int((len(signal) - 1) // period)) * period
        time = begins[:, None] + np.arange(int(period))
        cycles = np.interp(time, np.arange(len(signal)), signal - signal.mean())
        harmonic = (cycles * np.exp(-2j * np.pi * time / period)).sum(axis=1)
        turned = float(np.median(np.angle(harmonic[1:] * harmonic[:-1].conj())))
        period = period / (1.0 + turned / (2.0 * np.pi))
    return period


def _are_equal(cycles: Array) -> bool:
    """Tell whether no trend of their size goes beyond what a sample may differ by.

    Of a triangle a cycle's size also depends on where its samples meet the corners.
    """
    mean = cycles.mean(axis=0)
    moved = mean - mean.mean()
    size = cycles @ moved / (moved @ moved)
    place = np.linspace(-0.5, 0.5, len(size))
    trend = float(place @ size / (place @ place))
    return abs(trend) <= SAME and float(np.ptp(size)) <= SAME + 1.0 / cycles.shape[1]


def periodic_recordings(
    recordings: Sequence[Recording], axis: str
) -> tuple[PeriodicRecordings, ...]:
    """Return the recordings in which one axis alone is driven periodically, same lines together.

    recordings  any; those with breaks or with fewer than three periods are passed over
    """
    groups: dict[tuple[float, int, bytes], list[tuple[Recording, Repetition]]] = {}
    for recording in recordings:
        found = find_repetition(recording.voltage_V(axis)) if _usable(recording, axis) else None
        if found is None or found.periods < SETTLING + FEWEST:
            continue
        lines = _cut([(recording, found)], axis).excited_lines()
        key = (recording.sampling_rate_Hz, found.period_samples, lines.tobytes())
        groups.setdefault(key, []).append((recording, found))
    return tuple(
        PeriodicRecordings(names=tuple(r.name for r, _ in held), data=_cut(held, axis))
        for held in groups.values()
    )


def _period(steps: Array, fewest: int) -> int | None:
    """Lag of the first peak of the correlation, each lag over the energies it compares."""
    count = len(steps)
    padded = next_fast_len(2 * count, real=True)
    together = irfft(np.abs(rfft(steps, padded)) ** 2, padded)[: (count + 1) // fewest + 1]
    energy = np.concatenate([[0.0], np.cumsum(steps**2)])
    lag = np.arange(len(together))
    scale = np.sqrt(energy[count - lag] * (energy[-1] - energy[lag]))
    alike = together / np.maximum(scale, 1e-12 * energy[-1] + np.finfo(float).tiny)
    below = np.flatnonzero(alike < APART)
    if not len(below):
        return None
    above = below[0] + np.flatnonzero(alike[below[0] :] >= ALIKE)
    if not len(above):
        return None
    run = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1)[0]
    return int(run[np.argmax(alike[run])])


def _usable(recording: Recording, axis: str) -> bool:
    wanted = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    if recording.breaks or any(recording.find(quantity, axis) is None for quantity in wanted):
        return False
    reach_V = float(np.ptp(recording.voltage_V(axis)))
    others = [
        float(np.ptp(channel.values))
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE and channel.axis != axis
    ]
    return reach_V > 0.0 and all(other <= STILL * reach_V for other in others)


def _cut(held: Sequence[tuple[Recording, Repetition]], axis: str) -> PeriodicData:
    periods = min(found.periods for _, found in held) - SETTLING
    driven, moved = [], []
    for recording, found in held:
        P = found.period_samples
        start = found.first + (found.periods - periods) * P
        span = slice(start, start + periods * P)
        driven.append(recording.voltage_V(axis)[span].reshape(periods, P).T)
        moved.append(_undrifted(recording.displacement_m(axis)[span].reshape(periods, P).T))
    return PeriodicData(
        sampling_rate_Hz=held[0][0].sampling_rate_Hz,
        inputs=(axis,),
        outputs=(axis,),
        voltage_V=np.stack(driven, axis=1)[:, None],
        displacement_m=np.stack(moved, axis=1)[:, None],
    )


def _undrifted(moved_m: Array) -> Array:
    """(samples, periods) without the straight drift that the means of its periods show.

    What repeats has the same mean in every period; a straight line fitted to the samples
    themselves would take part of it away.
    """
    samples, periods = moved_m.shape
    place = np.arange(periods) - 0.5 * (periods - 1)
    per_period = float(place @ moved_m.mean(axis=0) / (place @ place))
    time = np.arange(samples * periods).reshape(periods, samples).T / samples
    return np.asarray(moved_m - per_period * (time - time.mean()))
