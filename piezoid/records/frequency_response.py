"""FrequencyResponseRecord: measured response at each frequency, and its summary without a fit."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array, ComplexArray, freeze, strictly_increasing
from piezoid.statement import Statement

CHAIN = ("amplifier", "sensor")
MIN_LINES = 3
MIN_COHERENCE = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponsePath:
    """The response of one axis to the drive of one axis.

    output, drive      names of the axes
    response_m_per_V   (lines,)  complex, never zero
    coherence          (lines,)  magnitude squared, 0 to 1; None if it was not measured
    """

    output: str
    drive: str
    response_m_per_V: ComplexArray
    coherence: Array | None = None

    def __post_init__(self) -> None:
        freeze(self, "response_m_per_V", dtype=np.complex128)
        response = self.response_m_per_V
        if not response.all():
            raise ValueError(f"response_m_per_V[{int(np.argmin(np.abs(response)))}] is zero")
        if self.coherence is None:
            return
        freeze(self, "coherence")
        coherence = self.coherence
        if len(coherence) != len(response) or coherence.min() < 0.0 or coherence.max() > 1.0:
            raise ValueError(
                f"coherence has {len(coherence)} values from {coherence.min():g} to "
                f"{coherence.max():g}, expected {len(response)} from 0 to 1"
            )

    @property
    def is_self_response(self) -> bool:
        """Whether output and drive belong to the same axis."""
        return self.output == self.drive

    @property
    def is_coherent(self) -> NDArray[np.bool_]:
        """Whether the coherence of each line is sufficient, (lines,)."""
        if self.coherence is None:
            return np.ones(len(self.response_m_per_V), dtype=np.bool_)
        return np.asarray(self.coherence >= MIN_COHERENCE)


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponseRecord:
    """One file of a network analyser, a lock-in or a controller's frequency sweep.

    name, digest    of the file
    frequency_Hz    (lines,)  > 0, increasing
    paths           no two of the same output and drive
    axis_is_named   whether the file or lab.toml names the axis; otherwise it is x
    includes        poles of the rig within the measured response, of ``CHAIN``
    statements      problems of the file
    """

    name: str
    digest: str
    frequency_Hz: Array
    paths: tuple[ResponsePath, ...]
    axis_is_named: bool = True
    includes: tuple[str, ...] = CHAIN
    statements: tuple[Statement, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "frequency_Hz")
        frequency_Hz = self.frequency_Hz
        strictly_increasing(frequency_Hz, "frequency_Hz")
        lines = len(frequency_Hz)
        if lines < MIN_LINES or not frequency_Hz[0] > 0.0:
            raise ValueError(
                f"frequency_Hz has {lines} values from {frequency_Hz[:1]} on, expected "
                f"{MIN_LINES} or more above zero"
            )
        pairs = [(path.output, path.drive) for path in self.paths]
        if not pairs or len(set(pairs)) < len(pairs):
            raise ValueError(f"paths are {pairs}, expected at least one, each once")
        for path in self.paths:
            if (path_lines := len(path.response_m_per_V)) != lines:
                raise ValueError(
                    f"{path.output}{path.drive} has {path_lines} lines, expected {lines}"
                )
        if unknown := set(self.includes) - set(CHAIN):
            raise ValueError(f"includes names {sorted(unknown)}, expected some of {CHAIN}")

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes with a measured response to their own drive."""
        return tuple(path.output for path in self.paths if path.is_self_response)

    def renamed(self, axis: str) -> "FrequencyResponseRecord":
        """Return the record of a single axis under another name of the axis."""
        paths = tuple(replace(path, output=axis, drive=axis) for path in self.paths)
        return replace(self, paths=paths, axis_is_named=True)

    def path(self, output: str, drive: str) -> ResponsePath | None:
        """Return one path, or None if it was not measured."""
        matches = [p for p in self.paths if (p.output, p.drive) == (output, drive)]
        return matches[0] if matches else None


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
    modes = []
    for peak in peaks.tolist():
        half, quality = gain[peak] / np.sqrt(2.0), None
        below = np.flatnonzero(gain[:peak] < half)
        above = np.flatnonzero(gain[peak:] < half)
        if len(below) and len(above):
            low, high = int(below[-1]), peak + int(above[0])
            low_Hz = np.interp(half, gain[low : low + 2], f[low : low + 2])
            falling = slice(high, high - 2, -1)
            high_Hz = np.interp(half, gain[falling], f[falling])
            quality = float(f[peak] / (high_Hz - low_Hz))
        modes.append(Peak(frequency_Hz=float(f[peak]), quality=quality))
    return tuple(modes)


def _is_low(frequency_Hz: Array, peaks: tuple[Peak, ...]) -> NDArray[np.bool_]:
    """Return which lines lie far below the first peak; the lowest lines are included."""
    first_Hz = min((peak.frequency_Hz for peak in peaks), default=frequency_Hz[-1])
    is_low = np.asarray(frequency_Hz < LOW_FREQUENCY * first_Hz)
    is_low[:MIN_LOW_LINES] = True
    return is_low
