"""Which recordings excite dynamics, and what they show behind a known hysteresis.

    u -> H -> v = (H[u] - y_off) / a -> G(s) -> y

H is the static operator found before, so that G sees a drive without hysteresis whatever the
amplitude; a, the middle of the operator's slope sector, only gives v the unit of a volt.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.frequency_response import ComplexArray, FrequencyResponse
from piezoid.identification.dynamics.periodic_estimate import smoothed
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity, Recording

LEAST_COHERENCE = 0.8
LEVEL_LINES = 33  # over which a random drive is as strong in one window as in another
OVERLAP_LOSS = 1.0 + 2.0 / 36.0  # Hann windows that overlap by half share (1/6)^2 of their power
MAIN_LOBE_LINES = 2  # a Hann window smears the mean over this many lines


_TINY = float(np.finfo(np.float64).tiny)

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


def estimate_response_by_coherence(
    voltage_V: Array,
    displacement_m: Array,
    *,
    sampling_rate_Hz: float,
    segment_samples: int,
    inputs: tuple[str, ...] = ("x",),
    outputs: tuple[str, ...] = ("x",),
) -> FrequencyResponse:
    """Return the least-squares response of averaged spectra and its multiple coherence.

        G = S_yu S_uu^-1,   coherence = 1 - (S_yy - G S_uy) / S_yy           [Bendat & Piersol]

    voltage_V        (samples,) or (samples, inputs)
    displacement_m   (samples,) or (samples, outputs)
    segment_samples  of each Hann window; windows overlap by half. Longer ones resolve sharper
                     resonances, more of them measure the coherence better

    A window must be long against the ring: damping comes out too large where 1/segment is not
    far below the width of a resonance. Distortion and noise cannot be told apart here. Lines are
    rejected below ``LEAST_COHERENCE``, or where the drive has no power.
    """
    drive, moved = _columns(voltage_V), _columns(displacement_m)
    U, Y = _windowed(drive, segment_samples), _windowed(moved, segment_samples)
    averages = _effective_averages(U)
    drive_power, cross = _cross(U, U), _cross(Y, U)
    inverse, is_driven = _safe_inverse(drive_power)
    G = cross @ inverse
    moved_power = np.einsum("kii->ki", _cross(Y, Y)).real
    explained = np.einsum("kij,kij->ki", G, np.conj(cross)).real
    coherence = np.where(is_driven[:, None], explained / np.maximum(moved_power, _TINY), 0.0)
    coherence = np.clip(coherence, 0.0, 1.0)
    freedom = _spare_averages(averages, drive.shape[1])
    residual = np.maximum(moved_power - explained, 0.0)
    per_input = np.einsum("kjj->kj", inverse).real[:, None, :]
    lines = np.arange(MAIN_LOBE_LINES, segment_samples // 2)
    variance = (residual / freedom[:, None])[:, :, None] * per_input
    return FrequencyResponse(
        inputs=inputs,
        outputs=outputs,
        sampling_rate_Hz=sampling_rate_Hz,
        frequency_Hz=lines * sampling_rate_Hz / segment_samples,
        response=G[lines],
        noise_variance=variance[lines],
        distortion_variance=np.zeros_like(variance[lines]),
        coherence=coherence[lines],
        is_interference=np.zeros_like(coherence[lines], dtype=np.bool_),
        is_rejected=coherence[lines] < LEAST_COHERENCE,
        least_coherence=LEAST_COHERENCE,
        variance_freedom=float(np.median(freedom)),
        drive_rms_V=drive.std(axis=0),
        realisations=1,
        periods=1,
    )


def _columns(values: Array) -> Array:
    array = np.asarray(values, dtype=np.float64)
    return array.reshape(len(array), -1)


def _windowed(channels: Array, length: int) -> ComplexArray:
    """Spectra of Hann windows, (lines, channels, windows)."""
    count = (len(channels) - length) // (length // 2) + 1
    if count < 4:
        raise ExcitationError(
            f"{len(channels)} samples hold {max(count, 0)} windows of {length}",
            needed="at least 4 windows, or the coherence says nothing",
            remedy="Choose shorter segments or record longer.",
        )
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    starts = np.arange(count) * (length // 2)
    pieces = channels[starts[:, None] + np.arange(length)]
    level = pieces - pieces.mean(axis=1, keepdims=True)
    return np.asarray(np.fft.rfft(level * window[None, :, None], axis=1).transpose(1, 2, 0))


def _cross(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    return np.asarray(left @ np.conj(np.swapaxes(right, 1, 2)))


def _effective_averages(U: ComplexArray) -> Array:
    """How many windows really drove each line: a chirp passes through few of them.

    Power is first smoothed over lines, so that the luck of random drives does not count.
    """
    power = smoothed((np.abs(U) ** 2).sum(axis=1), min(LEVEL_LINES, (len(U) - 1) // 2 * 2 + 1))
    squared = np.maximum((power**2).sum(axis=1), _TINY)
    return np.asarray(power.sum(axis=1) ** 2 / squared / OVERLAP_LOSS)


def _spare_averages(averages: Array, inputs: int) -> Array:
    """Averages left after fitting one coefficient per input, never below a half."""
    return np.asarray(np.maximum(averages - inputs, 0.5))


def _safe_inverse(power: ComplexArray) -> tuple[ComplexArray, NDArray[np.bool_]]:
    """Invert where every input has power of its own; elsewhere zero, and say so."""
    eigenvalues = np.linalg.eigvalsh(power)
    is_driven = eigenvalues[:, 0] > 1e-10 * eigenvalues.max()
    inverse = np.zeros_like(power)
    inverse[is_driven] = np.linalg.inv(power[is_driven])
    return inverse, is_driven
