"""Select recordings that excite the dynamics of an axis: broad-band drives to high frequency."""

from collections.abc import Sequence

import numpy as np

from piezoid.numerics.arrays import Array, runs_of
from piezoid.records.recording import Quantity, Recording

HIGHEST_Hz = 50.0  # a drive below shows hysteresis and creep, not dynamics
BANDS_PER_DECADE = 6
BROAD_dB = -40.0  # of the strongest band: weaker ones are leakage and harmonics of slow drives
BROAD_DECADES = 1.25  # between harmonics of a triangle there are empty bands; chirps have 1.3
# Of 58 stages of birch and alder (seeds 1-13, 101-111, 161-180) nine have a sweep that is not
# broad by that measure: four follow slow loops, 45 dB below their density (2.4 decades or more,
# 0.45 % of the power or more), five pass only the resonance (0.67 decades or more, 99 % of the
# power). Among other drives stairs are most similar: at most 1.04 decades and 2.7 %.
LEVEL_dB = -15.0  # within a band that is level
LEVEL_DECADES = 0.45  # three bands: one sine may lie in two
NARROW_SHARE = 0.5  # of the power: of a level band narrower than BROAD_DECADES
BROAD_SHARE = 1e-3  # white noise of a monitored drive would be 3 % of its rms


def excites_dynamics(
    recordings: Sequence[Recording], axis: str
) -> tuple[tuple[Recording, float], ...]:
    """Return the recordings with a broad and fast drive, and the highest frequency of each.

    A broad drive has power densities within 40 dB of the strongest in neighbouring sixths of a
    decade, over at least one and a quarter decades; or a level band, like a sweep through the
    resonance or behind slow loops: 0.45 decades with half the power, or one and a quarter decades
    with a thousandth of it. A fast drive reaches 50 Hz.
    """
    quantities = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    recorded = [r for r in recordings if all(r.find(q, axis) is not None for q in quantities)]
    highest = [(r, _highest_Hz(r.voltage_V(axis), r.sampling_rate_Hz)) for r in recorded]
    return tuple((recording, high_Hz) for recording, high_Hz in highest if high_Hz >= HIGHEST_Hz)


def most_exciting(recordings: Sequence[Recording], axis: str) -> Recording | None:
    """Return the recording with the highest excited frequency; None if none excites dynamics."""
    exciting = excites_dynamics(recordings, axis)
    return max(exciting, key=lambda pair: pair[1])[0] if exciting else None


def _highest_Hz(voltage_V: Array, sampling_rate_Hz: float) -> float:
    """Return the upper end of the band that the drive excites; 0 if there is none."""
    level = voltage_V - voltage_V.mean()
    lines = np.abs(np.fft.rfft(level * np.hanning(len(level)))) ** 2
    frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / sampling_rate_Hz)
    decades = np.log10(0.5 * sampling_rate_Hz / frequency_Hz[1]) if len(lines) > 2 else 0.0
    count = int(BANDS_PER_DECADE * decades)
    if count < 2:
        return 0.0
    edges = np.geomspace(frequency_Hz[1], 0.5 * sampling_rate_Hz, count + 1)
    band = np.clip(np.searchsorted(edges, frequency_Hz[1:], side="right") - 1, 0, count - 1)
    power = np.asarray(np.bincount(band, lines[1:], count), dtype=np.float64)
    if not power.any():
        return 0.0
    density = power / np.maximum(np.bincount(band, minlength=count), 1)
    strong = density >= 10.0 ** (BROAD_dB / 10.0) * density.max()
    first, stop = max(runs_of(strong), key=lambda run: run[1] - run[0])
    high_Hz = float(edges[stop])
    if high_Hz >= HIGHEST_Hz and high_Hz >= 10.0**BROAD_DECADES * edges[first]:
        return high_Hz
    # The drive is not broad: look for the widest flat band with enough power.
    widest, high_Hz = 0.0, 0.0
    for first in range(count):
        lowest = np.minimum.accumulate(density[first:])
        highest = np.maximum.accumulate(density[first:])
        stop = first + int((lowest > 10.0 ** (LEVEL_dB / 10.0) * highest).sum())
        width = float(np.log10(edges[stop] / edges[first]))
        share = power[first:stop].sum() / power.sum()
        is_level = width >= LEVEL_DECADES and share >= NARROW_SHARE
        is_level = is_level or (width >= BROAD_DECADES and share >= BROAD_SHARE)
        if is_level and width > widest:
            widest, high_Hz = width, float(edges[stop])
    return high_Hz
