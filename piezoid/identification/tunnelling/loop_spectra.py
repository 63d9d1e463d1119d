"""Spectra of reference, drive and log current, block by block.

All three signals are differenced first: G commutes with differences, and drift, which would leak
from the edges of the blocks to all lines, becomes a constant. A periodic dither is cut into its
periods, without leakage; any other dither into tapered blocks without overlap, which are
independent. A block contains the response to the drive just before it: with poles of 2 kHz and
blocks of 512 samples this reduces the gain by 0.2 %, more than noise does. The drive can therefore
be filtered by a plant close to the true plant before it is cut, so that only their ratio is
estimated.

Lines at multiples of 50 and 60 Hz are left out: mains hum repeats in every period that contains a
whole number of its cycles, and would look like a response to the dither.
"""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_files import LoopRecord
from piezoid.numerics.arrays import Array, ComplexArray

MIN_BLOCKS = 8
_MAINS_Hz = (50.0, 60.0)
_HIGHEST_MAINS_Hz = 500.0
_MIN_POWER = 1e-3  # of the strongest line; a periodic dither has no power at other lines


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopSpectra:
    """Fourier coefficients of one record.

    frequency_Hz  (lines,)
    reference     (blocks, lines)
    drive         (blocks, lines)  filtered by ``through``
    output        (blocks, lines)  of the log current
    through       plant by which the drive was filtered before it was cut; None: not filtered
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
    """Return the spectra at the lines excited by the dither, up to a highest frequency.

    through  plant close to the true one, by which the drive is filtered; None: not filtered
    """
    if record.period_samples is None:
        length = _block_length(record)
        taper = length // 20  # a twentieth of the length as cosine taper at either end
        window = np.ones(length)
        window[:taper] = 0.5 - 0.5 * np.cos(np.pi * (np.arange(taper) + 0.5) / max(taper, 1))
        window[length - taper :] = window[:taper][::-1]
    else:
        length, periods = record.period_samples, (record.samples - 1) // record.period_samples
        if periods < MIN_BLOCKS:
            raise ExcitationError(
                f"{record.label}: {record.samples} samples contain {periods} whole periods of "
                f"{length}, without the first sample",
                needed=f"at least {MIN_BLOCKS} periods, to separate the dither from the noise",
                remedy="Record longer, or shorten the dither's period.",
            )
        window = np.ones(length)
    spectra = _cut(record, length, length, window, through)
    inside = (spectra.frequency_Hz > 0.0) & (spectra.frequency_Hz <= highest_Hz)
    difference = 2.0 * np.sin(np.pi * spectra.frequency_Hz / record.sampling_rate_Hz)
    power = np.sum(np.abs(spectra.reference) ** 2, axis=0)
    power[inside] /= difference[inside] ** 2  # power of the dither, not of its differences
    for mains_Hz in _MAINS_Hz:  # lines within half a line of a harmonic
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
    inside &= power > _MIN_POWER * np.max(power[inside])
    return replace(
        spectra,
        frequency_Hz=spectra.frequency_Hz[inside],
        reference=spectra.reference[:, inside],
        drive=spectra.drive[:, inside],
        output=spectra.output[:, inside],
    )


def naive_gain(record: LoopRecord, *, highest_Hz: float, flat_Hz: float) -> tuple[float, float]:
    """Return the median of |S_yu / S_uu| at low frequency, and the share of the dither.

    The share is the part of the power of the drive that the dither explains, 0 to 1:
    |S_ur|^2 / (S_uu S_rr), averaged over all lines with the weight S_uu

    highest_Hz  of the lines
    flat_Hz     up to which the plant is flat
    """
    length = _block_length(record)
    spectra = _cut(record, length, length // 2, np.hanning(length + 1)[:-1])
    inside = (spectra.frequency_Hz > 0.0) & (spectra.frequency_Hz <= highest_Hz)
    drive, reference = spectra.drive[:, inside], spectra.reference[:, inside]
    cross = np.sum(spectra.output[:, inside] * drive.conj(), axis=0)
    gain = np.abs(cross) / np.maximum(np.sum(np.abs(drive) ** 2, axis=0), 1e-300)
    explained = np.abs(np.sum(drive * reference.conj(), axis=0)) ** 2
    explained /= np.maximum(np.sum(np.abs(reference) ** 2, axis=0), 1e-300)
    share = float(np.sum(explained) / np.sum(np.abs(drive) ** 2))
    return float(np.median(gain[spectra.frequency_Hz[inside] <= flat_Hz])), share


def _block_length(record: LoopRecord) -> int:
    """Return the power of two that gives at least 32 blocks without overlap."""
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
