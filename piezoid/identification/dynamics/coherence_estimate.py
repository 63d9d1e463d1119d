"""The response from chirps and noise, by averaged spectra, with coherence as its conscience."""

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.frequency_response import ComplexArray, FrequencyResponse
from piezoid.identification.dynamics.periodic_estimate import smoothed
from piezoid.numerics.arrays import Array

LEAST_COHERENCE = 0.8
LEVEL_LINES = 33  # over which a random drive is as strong in one window as in another
OVERLAP_LOSS = 1.0 + 2.0 / 36.0  # Hann windows that overlap by half share (1/6)^2 of their power
MAIN_LOBE_LINES = 2  # a Hann window smears the mean over this many lines


def estimate_response_by_coherence(
    voltage_V: Array,
    displacement_m: Array,
    *,
    sampling_rate_Hz: float,
    segment_samples: int,
    inputs: tuple[str, ...] = ("x",),
    outputs: tuple[str, ...] = ("x",),
    least_coherence: float = LEAST_COHERENCE,
) -> FrequencyResponse:
    """Return the least-squares response of averaged spectra and its multiple coherence.

        G = S_yu S_uu^-1,   coherence = 1 - (S_yy - G S_uy) / S_yy           [Bendat & Piersol]

    voltage_V        (samples,) or (samples, inputs)
    displacement_m   (samples,) or (samples, outputs)
    segment_samples  of each Hann window; windows overlap by half. Longer ones resolve sharper
                     resonances, more of them measure the coherence better

    A window must be long against the ring: damping comes out too large where 1/segment is not
    far below the width of a resonance. Distortion and noise cannot be told apart here. Lines are
    rejected below ``least_coherence``, or where the drive has no power.
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
        is_rejected=coherence[lines] < least_coherence,
        least_coherence=least_coherence,
        variance_freedom=float(np.median(freedom)),
        drive_rms_V=drive.std(axis=0),
        realisations=1,
        periods=1,
    )


_TINY = float(np.finfo(np.float64).tiny)


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
