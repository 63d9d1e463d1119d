"""Which recordings excite dynamics, and what they show behind a known hysteresis.

    u -> H -> v = (H[u] - y_off) / a -> G(s) -> y

H is the static operator found before, so that G sees a drive without hysteresis whatever the
amplitude; a, the middle of the operator's slope sector, only gives v the unit of a volt.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.identification.dynamics.coherence_estimate import estimate_response_by_coherence
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity, Recording

BROAD_dB = -40.0  # of the strongest band: weaker ones are leakage and harmonics of slow drives
BROAD_DECADES = 1.25  # between harmonics of a triangle there are empty bands; chirps have 1.3
HIGHEST_Hz = 50.0  # a drive that ends below shows hysteresis and creep, not dynamics
BANDS_PER_DECADE = 6
# Of 58 stages of birch and alder (seeds 1-13, 101-111, 161-180) nine hold a sweep that is not
# broad by that measure: four behind slow loops, 45 dB under their density (2.4 decades or more,
# 0.45 % of the power or more), five through the resonance alone (0.67 decades or more, 99 % of
# the power). Of drives that are no sweep stairs come nearest: at most 1.04 decades and 2.7 %.
LEVEL_dB = -15.0  # within a band that is level
LEVEL_DECADES = 0.45  # three bands: one sine may lie in two
SHARE_OF_NARROW = 0.5  # of the power: of a level band narrower than BROAD_DECADES
SHARE_OF_BROAD = 1e-3  # white noise of a monitored drive would be 3 % of its rms
HIGHEST_Hz = 50.0  # a drive that ends below shows hysteresis and creep, not dynamics
BANDS_PER_DECADE = 6
WINDOWS = 5  # a segment is at most this part of the recording: nine half-overlapping windows


def excites_dynamics(
    recordings: Sequence[Recording], axis: str
) -> tuple[tuple[Recording, float], ...]:
    """Return the recordings whose drive is broad and fast, with the highest frequency in it.

    Broad means: neighbouring sixths of a decade, together at least one and a quarter decades, hold
    power densities within 40 dB of the strongest; or they, as a sweep through the resonance or one
    behind slow loops do, hold a level band: 0.45 decades with half the power, or one and a quarter
    with a thousandth of it. Fast means that they reach 50 Hz.
    """
    both = [r for r in recordings if _has_both(r, axis)]
    ends = [(r, _highest_Hz(r.voltage_V(axis), r.sampling_rate_Hz)) for r in both]
    return tuple((recording, high_Hz) for recording, high_Hz in ends if high_Hz >= HIGHEST_Hz)


def measure_behind_hysteresis(axis: AxisModel, recording: Recording) -> FrequencyResponse:
    """Return the response from the hysteresis' output, as a drive, to the displacement.

    Lines that the drive did not reach or that are not coherent are marked as rejected.
    """
    return _measured(voltage_behind_hysteresis(axis, recording), recording, axis.axis)


def measure_from_drive(recording: Recording, axis: str) -> FrequencyResponse:
    """Return the response from the drive to the displacement, hysteresis and all."""
    return _measured(recording.voltage_V(axis), recording, axis)


def _measured(drive_V: Array, recording: Recording, axis: str) -> FrequencyResponse:
    segment = 2 ** int(np.log2(max(recording.samples // WINDOWS, 2)))
    return estimate_response_by_coherence(
        drive_V,
        recording.displacement_m(axis),
        sampling_rate_Hz=recording.sampling_rate_Hz,
        segment_samples=segment,
        inputs=(axis,),
        outputs=(axis,),
    )


def voltage_behind_hysteresis(axis: AxisModel, recording: Recording) -> Array:
    """Return v, (samples,) V; memory starts as the fit found it, or de-poled."""
    operator = axis.hysteresis
    starts = [s for s in axis.starts if s.recording == recording.name]
    memory_V = starts[0].memory_V if starts else operator.virgin_memory()
    moved_m, _ = operator.run(recording.voltage_V(axis.axis), memory_V)
    return np.asarray((moved_m - operator.displacement_offset_m) / middle_slope_m_per_V(axis))


def middle_slope_m_per_V(axis: AxisModel) -> float:
    """Return a, the middle of the slope sector."""
    return 0.5 * sum(axis.hysteresis.slope_sector_m_per_V)


def _has_both(recording: Recording, axis: str) -> bool:
    wanted = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    return all(recording.find(quantity, axis) is not None for quantity in wanted)


def _highest_Hz(voltage_V: Array, sampling_rate_Hz: float) -> float:
    """Return the upper end of the band that the drive fills; 0 where it fills none."""
    edges, power, lines = _bands(voltage_V, sampling_rate_Hz)
    if len(power) < 2 or not power.any():
        return 0.0
    density = power / np.maximum(lines, 1)
    strong = density >= 10.0 ** (BROAD_dB / 10.0) * density.max()
    runs = np.flatnonzero(np.diff(np.concatenate([[False], strong, [False]]).astype(int)))
    first, after = max(zip(runs[::2], runs[1::2], strict=True), key=lambda run: run[1] - run[0])
    high_Hz = float(edges[after])
    if high_Hz >= HIGHEST_Hz and high_Hz >= 10.0**BROAD_DECADES * edges[first]:
        return high_Hz
    return _highest_level_Hz(edges, power, density)


def _highest_level_Hz(edges: Array, power: Array, density: Array) -> float:
    """Return the upper end of the widest band that is level and holds enough; 0 for none."""
    widest, high_Hz = 0.0, 0.0
    for first in range(len(density)):
        least = np.minimum.accumulate(density[first:])
        most = np.maximum.accumulate(density[first:])
        wide = int((least > 10.0 ** (LEVEL_dB / 10.0) * most).sum())
        after = first + wide
        decades = float(np.log10(edges[after] / edges[first]))
        share = power[first:after].sum() / power.sum()
        is_level = decades >= LEVEL_DECADES and share >= SHARE_OF_NARROW
        is_level = is_level or (decades >= BROAD_DECADES and share >= SHARE_OF_BROAD)
        if is_level and decades > widest:
            widest, high_Hz = decades, float(edges[after])
    return high_Hz


def _bands(voltage_V: Array, sampling_rate_Hz: float) -> tuple[Array, Array, Array]:
    """Return edges of bands up to Nyquist, (bands + 1,) Hz, their power and number of lines."""
    level = voltage_V - voltage_V.mean()
    power = np.abs(np.fft.rfft(level * np.hanning(len(level)))) ** 2
    frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / sampling_rate_Hz)
    decades = np.log10(0.5 * sampling_rate_Hz / frequency_Hz[1]) if len(power) > 2 else 0.0
    count = int(BANDS_PER_DECADE * decades)
    if count < 2:
        return np.ones(2), np.zeros(1), np.ones(1)
    edges = np.geomspace(frequency_Hz[1], 0.5 * sampling_rate_Hz, count + 1)
    place = np.clip(np.searchsorted(edges, frequency_Hz[1:], side="right") - 1, 0, count - 1)
    lines = np.bincount(place, minlength=count).astype(float)
    return np.asarray(edges), np.asarray(np.bincount(place, power[1:], count)), lines
