"""Select recordings that excite the dynamics, and estimate responses behind the hysteresis.

    u -> H -> v = (H[u] - y_off) / a -> G(s) -> y

H is the static operator fitted before, so that the response from v to y is free of hysteresis at
any amplitude. a, the middle of the slope sector of the operator, scales v to volts.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.identification.dynamics.frequency_response import FrequencyResponse, smooth_lines
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, runs_of
from piezoid.records.recording import Quantity, Recording

MIN_COHERENCE = 0.8
WINDOWS = 5  # segments in a recording, at least: nine half-overlapping windows
LEVEL_LINES = 33  # over which the power of a random drive is equal in all windows
OVERLAP_LOSS = 1.0 + 2.0 / 36.0  # Hann windows that overlap by half share (1/6)^2 of their power
MAIN_LOBE_LINES = 2  # over which a Hann window smears the mean
MIN_POWER = 1e-10  # of the strongest line: weaker lines are not driven
TINY = float(np.finfo(np.float64).tiny)
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
DRIVEN_SHARE = 0.99  # the last hundredth may be leakage, or noise of a measured drive
BROAD_SHARE = 1e-3  # white noise of a monitored drive would be 3 % of its rms


def measure_response(drive_V: Array, recording: Recording, axis: str) -> FrequencyResponse:
    """Return the response of the displacement in a recording to a drive.

    drive_V  (samples,)  of the recording, or ``voltage_behind_hysteresis``

    Lines without drive or coherence are marked as rejected.
    """
    return estimate_response_by_coherence(
        drive_V,
        recording.displacement_m(axis),
        sampling_rate_Hz=recording.sampling_rate_Hz,
        segment_samples=2 ** int(np.log2(max(recording.samples // WINDOWS, 2))),
        axis=axis,
    )


def voltage_behind_hysteresis(axis: AxisModel, recording: Recording) -> Array:
    """Return v, (samples,) V, from the fitted initial memory, or that of a virgin ceramic."""
    operator = axis.hysteresis
    starts = axis.starts_of(recording)
    memory_V = starts[0].memory_V if starts else operator.virgin_memory()
    static_m, _ = operator.run(recording.voltage_V(axis.axis), memory_V)
    return np.asarray((static_m - operator.displacement_offset_m) / operator.middle_slope_m_per_V)


def estimate_response_by_coherence(
    voltage_V: Array,
    displacement_m: Array,
    *,
    sampling_rate_Hz: float,
    segment_samples: int,
    axis: str = "x",
) -> FrequencyResponse:
    """Return the least-squares response and the coherence from averaged spectra.

        G = S_yu / S_uu,   coherence = |S_yu|^2 / (S_uu S_yy)                [Bendat & Piersol]

    voltage_V, displacement_m  (samples,)
    segment_samples  of each Hann window; windows overlap by half. Longer windows resolve sharper
                     resonances, more windows give a better coherence

    A window must be long compared with the ringing: the damping is overestimated if 1/segment is
    not far below the width of a resonance. Distortion and noise cannot be distinguished. Lines are
    rejected below ``MIN_COHERENCE``, or if the drive has no power.
    """
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(segment_samples) / segment_samples)

    spectra = []  # of half-overlapping Hann windows, (lines, windows)
    for signal in (voltage_V, displacement_m):
        pieces = np.lib.stride_tricks.sliding_window_view(signal, segment_samples)
        pieces = pieces[:: segment_samples // 2]
        level = pieces - pieces.mean(axis=1, keepdims=True)
        spectra.append(np.asarray(np.fft.rfft(level * window, axis=1).T))
    U, Y = spectra
    drive, output = (np.abs(U) ** 2).sum(axis=1), (np.abs(Y) ** 2).sum(axis=1)
    cross = (Y * U.conj()).sum(axis=1)
    is_driven = drive > MIN_POWER * drive.max()
    inverse = np.where(is_driven, 1.0 / np.where(is_driven, drive, 1.0), 0.0)
    explained = np.abs(cross) ** 2 * inverse
    coherence = np.where(is_driven, explained / np.maximum(output, TINY), 0.0)
    # Number of windows that drive each line: a chirp passes through few of them. The power is
    # first smoothed over lines, to average the fluctuations of random drives.
    power = smooth_lines(np.abs(U) ** 2, min(LEVEL_LINES, (len(U) - 1) // 2 * 2 + 1))
    squared = np.maximum((power**2).sum(axis=1), TINY)
    freedom = np.maximum(power.sum(axis=1) ** 2 / squared / OVERLAP_LOSS - 1.0, 0.5)
    variance = np.maximum(output - explained, 0.0) / freedom * inverse
    lines = np.arange(MAIN_LOBE_LINES, segment_samples // 2)
    coherence = np.clip(coherence[lines], 0.0, 1.0)
    return FrequencyResponse(
        axis=axis,
        sampling_rate_Hz=sampling_rate_Hz,
        frequency_Hz=lines * sampling_rate_Hz / segment_samples,
        response=(cross * inverse)[lines],
        variance=variance[lines],
        coherence=coherence,
        is_interference=np.zeros(coherence.shape, dtype=np.bool_),
        is_rejected=coherence < MIN_COHERENCE,
        least_coherence=MIN_COHERENCE,
        variance_freedom=float(np.median(freedom)),
        drive_rms_V=float(voltage_V.std()),
    )


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


def driven_Hz(voltage_V: Array, sampling_rate_Hz: float) -> float:
    """Return the frequency below which the drive has ``DRIVEN_SHARE`` of its weighted power.

    The window is rectangular: any other hides the end of a chirp.

        sum of f |U(f)|^2,   the same in every hertz of a logarithmic chirp
    """
    level = voltage_V - np.linspace(voltage_V[0], voltage_V[-1], len(voltage_V))
    frequency_Hz = np.fft.rfftfreq(len(level), 1.0 / sampling_rate_Hz)
    power = np.cumsum(frequency_Hz * np.abs(np.fft.rfft(level)) ** 2)
    return float(frequency_Hz[np.searchsorted(power, DRIVEN_SHARE * power[-1])])


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
