"""What a frequency response shows at first sight: its band, its peaks, how its axes couple."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.records.frequency_response import (
    FEWEST_LINES,
    FrequencyResponseRecord,
    ResponsePath,
)

SHARP_dB = 3.0  # by how much a peak rises above both of its sides
LEAST_PEAK = 0.1  # of the gain of the lowest lines: noise far above all modes has peaks as well
FAR_BELOW = 0.1  # of a mode's frequency: there it lifts the response by 1 % at most
ANY_LOW = 3  # lines that stand for low frequency where none is so far below


@dataclass(frozen=True, kw_only=True)
class PathSummary:
    """One path, at first sight.

    gain_m_per_V  size of the response far below the first peak, or of its lowest lines
    has_coherence whether it was measured
    coherent      lines that may be used
    peaks         that look like modes
    """

    output: str
    drive: str
    gain_m_per_V: float
    has_coherence: bool
    coherent: int
    peaks: "tuple[Peak, ...]"


@dataclass(frozen=True, kw_only=True)
class ResponseSummary:
    """One frequency response, at first sight.

    lowest_Hz, highest_Hz, lines  its band
    includes   poles of the rig it was measured through
    """

    lowest_Hz: float
    highest_Hz: float
    lines: int
    includes: tuple[str, ...]
    paths: tuple[PathSummary, ...]
    couplings: "tuple[Coupling, ...]"


def summary_of(record: FrequencyResponseRecord) -> ResponseSummary:
    """Return what one file shows at first sight."""
    return ResponseSummary(
        lowest_Hz=float(record.frequency_Hz[0]),
        highest_Hz=float(record.frequency_Hz[-1]),
        lines=len(record.frequency_Hz),
        includes=record.includes,
        paths=tuple(_path(record, path) for path in record.paths),
        couplings=couplings(record),
    )


def _path(record: FrequencyResponseRecord, path: ResponsePath) -> PathSummary:
    peaks = apparent_modes(record.frequency_Hz, path)
    low = _low(record.frequency_Hz, peaks)
    return PathSummary(
        output=path.output,
        drive=path.drive,
        gain_m_per_V=float(np.median(np.abs(path.response_m_per_V[low]))),
        has_coherence=path.coherence is not None,
        coherent=int(path.is_coherent.sum()),
        peaks=peaks if path.is_own else (),
    )


@dataclass(frozen=True, kw_only=True)
class Peak:
    """A maximum of a response that looks like a mode; no fit stands behind it.

    frequency_Hz  of the highest line
    quality       frequency over the width at which the gain is 3 dB lower; None where a side does
                  not fall so far
    """

    frequency_Hz: float
    quality: float | None


def apparent_modes(frequency_Hz: Array, path: ResponsePath) -> tuple[Peak, ...]:
    """Return the coherent maxima that rise by ``SHARP_dB`` above what lies on both sides.

    Those below ``LEAST_PEAK`` of the gain of the lowest lines do not count.
    """
    from scipy.signal import find_peaks

    kept = path.is_coherent
    f, gain = frequency_Hz[kept], np.abs(path.response_m_per_V[kept])
    if len(f) < FEWEST_LINES:
        return ()
    level = 20.0 * np.log10(gain / np.median(gain[:ANY_LOW]))
    places, _ = find_peaks(level, prominence=SHARP_dB, height=20.0 * np.log10(LEAST_PEAK))
    return tuple(Peak(frequency_Hz=float(f[k]), quality=_quality(f, gain, int(k))) for k in places)


def _quality(frequency_Hz: Array, gain: Array, place: int) -> float | None:
    """Return frequency over half-power width of one maximum, None where a side is missing."""
    half = gain[place] / np.sqrt(2.0)
    below = np.flatnonzero(gain[:place] < half)
    above = np.flatnonzero(gain[place:] < half)
    if not len(below) or not len(above):
        return None
    low, high = int(below[-1]), place + int(above[0])
    low_Hz = np.interp(half, gain[low : low + 2], frequency_Hz[low : low + 2])
    falling = slice(high, high - 2, -1)
    high_Hz = np.interp(half, gain[falling], frequency_Hz[falling])
    return float(frequency_Hz[place] / (high_Hz - low_Hz))


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """How much of the motion of a drive's own axis another axis makes of the same drive.

    low          median of |G_od / G_dd| far below the first apparent mode, or of the lowest lines
    at_mode      at the first apparent mode of the drive's axis; None where there is none
    """

    output: str
    drive: str
    low: float
    at_mode: float | None


def couplings(record: FrequencyResponseRecord) -> tuple[Coupling, ...]:
    """Return the coupling of every path beside those of an axis to its own drive."""
    found = []
    for path in record.paths:
        own = record.path(path.drive, path.drive)
        if path.is_own or own is None:
            continue
        ratio = np.abs(path.response_m_per_V / own.response_m_per_V)
        peaks = apparent_modes(record.frequency_Hz, own)
        low = _low(record.frequency_Hz, peaks)
        at_mode = (
            float(ratio[np.searchsorted(record.frequency_Hz, peaks[0].frequency_Hz)])
            if peaks
            else None
        )
        found.append(
            Coupling(
                output=path.output,
                drive=path.drive,
                low=float(np.median(ratio[low])),
                at_mode=at_mode,
            )
        )
    return tuple(found)


def _low(frequency_Hz: Array, peaks: tuple[Peak, ...]) -> NDArray[np.bool_]:
    """Tell the lines far below the first peak; the lowest ones where none is so far below."""
    first_Hz = min((peak.frequency_Hz for peak in peaks), default=frequency_Hz[-1])
    low = np.asarray(frequency_Hz < FAR_BELOW * first_Hz)
    low[:ANY_LOW] = True
    return low
