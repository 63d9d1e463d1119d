"""Summary of a frequency response without a fit: band, peaks, coupling of the axes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.records.frequency_response import (
    MIN_LINES,
    FrequencyResponseRecord,
    ResponsePath,
)

MIN_PROMINENCE_dB = 3.0  # of a peak above both of its sides
MIN_PEAK = 0.1  # of the gain of the lowest lines: noise above all modes has peaks, too
LOW_FREQUENCY = 0.1  # of a mode's frequency; below, the mode raises the response by 1 % at most
MIN_LOW_LINES = 3  # lowest lines that count as low frequency in any case


@dataclass(frozen=True, kw_only=True)
class Peak:
    """A maximum of a response that is probably a mode.

    frequency_Hz  of the highest line
    quality       frequency over the width at which the gain is 3 dB lower; None if a side does not
                  fall so far
    """

    frequency_Hz: float
    quality: float | None


@dataclass(frozen=True, kw_only=True)
class PathSummary:
    """Summary of one path.

    gain_m_per_V   gain far below the first peak, or of the lowest lines
    has_coherence  whether the coherence was measured
    coherent       number of usable lines
    peaks          maxima that are probably modes
    """

    output: str
    drive: str
    gain_m_per_V: float
    has_coherence: bool
    coherent: int
    peaks: tuple[Peak, ...]


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """Motion of another axis by the same drive, relative to that of the axis of the drive.

    low      median of |G_od / G_dd| far below the first apparent mode, or of the lowest lines
    at_mode  |G_od / G_dd| at the first apparent mode of the drive's axis, or None
    """

    output: str
    drive: str
    low: float
    at_mode: float | None


@dataclass(frozen=True, kw_only=True)
class ResponseSummary:
    """Summary of one frequency response.

    lowest_Hz, highest_Hz, lines  its band
    includes   poles of the rig it was measured through
    """

    lowest_Hz: float
    highest_Hz: float
    lines: int
    includes: tuple[str, ...]
    paths: tuple[PathSummary, ...]
    couplings: tuple[Coupling, ...]


def summary_of(record: FrequencyResponseRecord) -> ResponseSummary:
    """Summarise one response file without a fit."""
    frequency_Hz = record.frequency_Hz
    paths, couplings = [], []
    for path in record.paths:
        peaks = apparent_modes(frequency_Hz, path)
        is_low = _is_low(frequency_Hz, peaks)
        paths.append(
            PathSummary(
                output=path.output,
                drive=path.drive,
                gain_m_per_V=float(np.median(np.abs(path.response_m_per_V[is_low]))),
                has_coherence=path.coherence is not None,
                coherent=int(path.is_coherent.sum()),
                peaks=peaks if path.is_self_response else (),
            )
        )
        self_response = record.path(path.drive, path.drive)
        if path.is_self_response or self_response is None:
            continue
        ratio = np.abs(path.response_m_per_V / self_response.response_m_per_V)
        modes = apparent_modes(frequency_Hz, self_response)
        at_mode = None
        if modes:
            at_mode = float(ratio[np.searchsorted(frequency_Hz, modes[0].frequency_Hz)])
        low = float(np.median(ratio[_is_low(frequency_Hz, modes)]))
        couplings.append(Coupling(output=path.output, drive=path.drive, low=low, at_mode=at_mode))
    return ResponseSummary(
        lowest_Hz=float(frequency_Hz[0]),
        highest_Hz=float(frequency_Hz[-1]),
        lines=len(frequency_Hz),
        includes=record.includes,
        paths=tuple(paths),
        couplings=tuple(couplings),
    )


def apparent_modes(frequency_Hz: Array, path: ResponsePath) -> tuple[Peak, ...]:
    """Return the coherent maxima that rise by ``MIN_PROMINENCE_dB`` above both of their sides.

    Maxima below ``MIN_PEAK`` of the gain of the lowest lines are ignored.
    """
    from scipy.signal import find_peaks

    f, gain = frequency_Hz[path.is_coherent], np.abs(path.response_m_per_V[path.is_coherent])
    if len(f) < MIN_LINES:
        return ()
    level_dB = 20.0 * np.log10(gain / np.median(gain[:MIN_LOW_LINES]))
    peaks, _ = find_peaks(level_dB, prominence=MIN_PROMINENCE_dB, height=20.0 * np.log10(MIN_PEAK))
    return tuple(
        Peak(frequency_Hz=float(f[k]), quality=_quality(f, gain, k)) for k in peaks.tolist()
    )


def _quality(frequency_Hz: Array, gain: Array, peak: int) -> float | None:
    """Return frequency over half-power width of one maximum; None if one side is missing."""
    half = gain[peak] / np.sqrt(2.0)
    below = np.flatnonzero(gain[:peak] < half)
    above = np.flatnonzero(gain[peak:] < half)
    if not len(below) or not len(above):
        return None
    low, high = int(below[-1]), peak + int(above[0])
    low_Hz = np.interp(half, gain[low : low + 2], frequency_Hz[low : low + 2])
    falling = slice(high, high - 2, -1)
    high_Hz = np.interp(half, gain[falling], frequency_Hz[falling])
    return float(frequency_Hz[peak] / (high_Hz - low_Hz))


def _is_low(frequency_Hz: Array, peaks: tuple[Peak, ...]) -> NDArray[np.bool_]:
    """Return which lines lie far below the first peak; the lowest lines are included."""
    first_Hz = min((peak.frequency_Hz for peak in peaks), default=frequency_Hz[-1])
    is_low = np.asarray(frequency_Hz < LOW_FREQUENCY * first_Hz)
    is_low[:MIN_LOW_LINES] = True
    return is_low
