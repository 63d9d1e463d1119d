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
WINDOWS = 5  # a segment is at most this part of the recording: nine half-overlapping windows


def excites_dynamics(
    recordings: Sequence[Recording], axis: str
) -> tuple[tuple[Recording, float], ...]:
    """Return the recordings whose drive is broad and fast, with the highest frequency in it.

    Broad means: neighbouring sixths of a decade, together at least one and a quarter decades, hold
    power densities within 40 dB; fast, that they reach 50 Hz.
    """
    both = [r for r in recordings if _has_both(r, axis)]
    bands = [(r, _band_Hz(r.voltage_V(axis), r.sampling_rate_Hz)) for r in both]
    return tuple(
        (recording, high_Hz)
        for recording, (low_Hz, high_Hz) in bands
        if high_Hz >= HIGHEST_Hz and high_Hz >= 10.0**BROAD_DECADES * low_Hz
    )


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


def _band_Hz(voltage_V: Array, sampling_rate_Hz: float) -> tuple[float, float]:
    """Return the ends of the broadest band in which the drive is strong throughout."""
    level = voltage_V - voltage_V.mean()
    power = np.abs(np.fft.rfft(level * np.hanning(len(level)))) ** 2
    frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / sampling_rate_Hz)
    decades = np.log10(0.5 * sampling_rate_Hz / frequency_Hz[1]) if len(power) > 2 else 0.0
    count = int(BANDS_PER_DECADE * decades)
    if count < 2 or not power.any():
        return 1.0, 0.0
    edges = np.geomspace(frequency_Hz[1], 0.5 * sampling_rate_Hz, count + 1)
    place = np.clip(np.searchsorted(edges, frequency_Hz[1:], side="right") - 1, 0, count - 1)
    total = np.bincount(place, power[1:], count) / np.maximum(
        np.bincount(place, minlength=count), 1
    )
    strong = total >= 10.0 ** (BROAD_dB / 10.0) * total.max()
    runs = np.flatnonzero(np.diff(np.concatenate([[False], strong, [False]]).astype(int)))
    first, after = max(zip(runs[::2], runs[1::2], strict=True), key=lambda run: run[1] - run[0])
    return float(edges[first]), float(edges[after])
