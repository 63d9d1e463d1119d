"""Spectra of reference, drive and log current, block by block.

All three signals are differenced first: G commutes with that, and drift, which would leak from
the block edges over every line, becomes a constant. A periodic dither is cut into its periods, so
that nothing leaks at all; any other is cut into tapered blocks, not overlapping, so that they
are independent witnesses. What the drive did just before a block is answered inside it: with
poles of 2 kHz and blocks of 512 that takes 0.2 % off the gain, more than noise does. So the drive
can be passed through a plant near the true one before it is cut, and only the ratio is left.

Lines at multiples of 50 and of 60 Hz are left out: mains hum repeats with every period whose
length is a whole number of its cycles, and would pass for an answer to the dither.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord
from piezoid.numerics.arrays import Array, ComplexArray

FEWEST_BLOCKS = 8
_MAINS_Hz = (50.0, 60.0)
_HIGHEST_MAINS_Hz = 500.0
_LEAST_LINE = 1e-3  # of the strongest line's power; a periodic dither has none elsewhere


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopSpectra:
    """Fourier coefficients of one record.

    frequency_Hz  (lines,)
    reference     (blocks, lines)
    drive         (blocks, lines)  behind ``through`` where there is one
    output        (blocks, lines)  of the log current
    through       the plant that the drive was passed through before it was cut
    """

    frequency_Hz: Array
    reference: ComplexArray
    drive: ComplexArray
    output: ComplexArray
    through: JunctionPlant | None = None

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.reference)


def spectra_of_dither(
    record: LoopRecord, *, highest_Hz: float, through: JunctionPlant | None = None
) -> LoopSpectra:
    """Return the spectra on the lines the dither excites, up to a highest frequency.

    through  a plant near the true one for the drive to pass; None: the drive as it is
    """
    if record.period_samples is None:
        length = _block_length(record)
        taper = length // 20  # a twentieth of the length as cosine taper at either end
        window = np.ones(length)
        window[:taper] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(taper) + 0.5) / max(taper, 1))
        window[length - taper :] = window[:taper][::-1]
    else:
        length, periods = record.period_samples, (record.samples - 1) // record.period_samples
        if periods < FEWEST_BLOCKS:
            raise ExcitationError(
                f"{record.label}: {record.samples} samples hold {periods} whole periods of "
                f"{length}, the first sample lost to the difference",
                needed=f"at least {FEWEST_BLOCKS} periods, to separate the dither from the noise",
                remedy="Record longer, or shorten the dither's period.",
            )
        window = np.ones(length)
    spectra = _cut(record, length, length, window, through)
    inside = (spectra.frequency_Hz > 0.0) & (spectra.frequency_Hz <= highest_Hz)
    difference = 2.0 * np.sin(np.pi * spectra.frequency_Hz / record.sampling_rate_Hz)
    power = np.sum(np.abs(spectra.reference) ** 2, axis=0)
    power[inside] /= difference[inside] ** 2  # of the dither itself, not of its differences
    for mains_Hz in _MAINS_Hz:  # lines on which a harmonic falls, to half a line
        harmonic_Hz = np.maximum(np.round(spectra.frequency_Hz / mains_Hz), 1.0) * mains_Hz
        distance_Hz = np.abs(spectra.frequency_Hz - harmonic_Hz)
        is_mains = distance_Hz < 0.5 * record.sampling_rate_Hz / length
        inside &= ~(is_mains & (spectra.frequency_Hz <= _HIGHEST_MAINS_Hz))
    if not np.max(power[inside], initial=0.0) > 0.0:
        raise ExcitationError(
            f"{record.label}: the reference does not move",
            needed="a dither that does not depend on the current",
            remedy="Add a small multisine to the set point or to the drive and record it.",
        )
    return _lines(spectra, inside & (power > _LEAST_LINE * np.max(power[inside])))


def naive_gain(record: LoopRecord, *, highest_Hz: float, flat_Hz: float) -> tuple[float, float]:
    """Return the gain of a plain transfer function where the plant is flat, and dither's share.

    The share is how much of the drive's power the dither explains, 0 to 1:
    |S_ur|^2 / (S_uu S_rr), summed over all lines with the weight S_uu

    highest_Hz, flat_Hz  the lines end there; the plant is flat up to there
    """
    length = _block_length(record)
    spectra = _cut(record, length, length // 2, np.hanning(length + 1)[:-1])
    f = spectra.frequency_Hz
    spectra = _lines(spectra, (f > 0.0) & (f <= highest_Hz))
    drive, reference = spectra.drive, spectra.reference
    cross = np.sum(spectra.output * drive.conj(), axis=0)
    gain = np.abs(cross) / np.maximum(np.sum(np.abs(drive) ** 2, axis=0), 1e-300)
    explained = np.abs(np.sum(drive * reference.conj(), axis=0)) ** 2
    explained /= np.maximum(np.sum(np.abs(reference) ** 2, axis=0), 1e-300)
    share = float(np.sum(explained) / np.sum(np.abs(drive) ** 2))
    return float(np.median(gain[spectra.frequency_Hz <= flat_Hz])), share


def _block_length(record: LoopRecord) -> int:
    """A power of two that leaves at least thirty-two blocks without overlap."""
    return max(int(2 ** np.floor(np.log2(record.samples / 33))), 16)


def _cut(
    record: LoopRecord,
    length: int,
    advance: int,
    window: Array,
    through: JunctionPlant | None = None,
) -> LoopSpectra:
    drive_V = np.diff(record.drive_V)
    signals = (
        np.diff(record.reference),
        drive_V if through is None else through.respond(drive_V),
        np.diff(record.log_current),
    )
    transformed = []
    for signal in signals:
        blocks = np.lib.stride_tricks.sliding_window_view(signal, length)[::advance]
        transformed.append(np.fft.rfft(blocks * window, axis=1))
    return LoopSpectra(
        frequency_Hz=np.asarray(np.fft.rfftfreq(length, 1.0 / record.sampling_rate_Hz), float),
        reference=transformed[0],
        drive=transformed[1],
        output=transformed[2],
        through=through,
    )


def _lines(spectra: LoopSpectra, is_used: NDArray[np.bool_]) -> LoopSpectra:
    return replace(
        spectra,
        frequency_Hz=spectra.frequency_Hz[is_used],
        reference=spectra.reference[:, is_used],
        drive=spectra.drive[:, is_used],
        output=spectra.output[:, is_used],
    )
