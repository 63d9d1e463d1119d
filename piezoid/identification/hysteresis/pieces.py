"""Uninterrupted pieces of drive and displacement in scaled units."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array, Samples, freeze
from piezoid.numerics.executor import Once
from piezoid.operators.filters import relaxed
from piezoid.operators.play import turns_of
from piezoid.records.constant_drive import is_at_rest
from piezoid.records.recording import Recording

MINIMUM_SAMPLES = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """Declared poles in front of and behind the hysteresis.

    amplifier_bandwidth_Hz  first-order pole of the drive, None: not declared
    sensor_bandwidth_Hz     first-order pole of the measurement, None: not declared
    """

    amplifier_bandwidth_Hz: float | None = None
    sensor_bandwidth_Hz: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Scales:
    """How volts and metres become numbers of order one.

    voltage_V        half the range of the drive
    voltage_offset_V its middle
    displacement_m   half the range of the displacement, negative where it falls as the drive rises
    """

    voltage_V: float
    voltage_offset_V: float
    displacement_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """One uninterrupted stretch of one recording.

    name              the recording's name
    recording         its number among the recordings of the fit
    sampling_rate_Hz  > 0
    drive             (samples,)  scaled, behind the declared amplifier
    response          (samples,)  scaled, about zero
    centre_m          what was subtracted from the displacement before scaling
    first, last       rows that count; states are followed from sample 0 whatever ``first`` is
    lost              (count,)  samples that are no measurement: they do not count
    begin             sample of the recording at which the piece begins
    """

    name: str
    recording: int
    sampling_rate_Hz: float
    drive: Array
    response: Array
    centre_m: float
    first: int
    last: int
    lost: Samples = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    begin: int = 0

    def __post_init__(self) -> None:
        freeze(self, "drive", "response")

    @Once
    def turns(self) -> NDArray[np.bool_]:
        """Which samples of the drive are its first or a turn, (samples,)."""
        return turns_of(self.drive)

    @property
    def rows(self) -> int:
        """How many samples there are from the first that counts to the last."""
        return self.last - self.first

    @property
    def fitted_drive(self) -> Array:
        """The drive from the first sample that counts to the last, (rows,)."""
        return self.drive[self.first : self.last]

    @property
    def fitted_response(self) -> Array:
        """The response from the first sample that counts to the last, (rows,)."""
        return self.response[self.first : self.last]

    def counting(self, stride: int = 1) -> Samples:
        """Return every ``stride``-th of the samples that count, without those lost, (rows,)."""
        sample = np.arange(self.first, self.last, stride)
        return np.setdiff1d(sample, self.lost, assume_unique=True) if len(self.lost) else sample


def response_range(pieces: Sequence[Piece]) -> float:
    """Return the range of the response in the piece in which it is widest."""
    return max(float(np.ptp(piece.fitted_response)) for piece in pieces)


def widest_swing(pieces: Sequence[Piece]) -> tuple[float, float]:
    """Return from where to where the drive goes in the piece in which it goes furthest."""
    drives = [piece.drive[: piece.last] for piece in pieces]
    widest = max(drives, key=lambda drive: float(np.ptp(drive)))
    return float(widest.min()), float(widest.max())


def scales_of(recordings: Sequence[Recording], axis: str) -> Scales:
    """Return the scales of a set of recordings of one axis.

    Raises ``ExcitationError`` where the drive or the displacement does not move.
    """
    drives = [recording.voltage_V(axis) for recording in recordings]
    rests = all(is_at_rest(recording, axis) for recording in recordings)
    low, high = min(float(u.min()) for u in drives), max(float(u.max()) for u in drives)
    spans = [float(np.ptp(recording.displacement_m(axis))) for recording in recordings]
    names = ", ".join(recording.name for recording in recordings)
    noise = " but for the noise of its reading" if high > low else ""
    for what, never in (
        (f"drive of axis {axis} never changes{noise}", rests),
        (f"displacement of axis {axis} never changes", max(spans) <= 0.0),
    ):
        if never:
            raise ExcitationError(
                f"{names}: the {what}",
                needed="a sweep over the range the stage is used in",
                remedy="Check which column is which, or record a sweep; drift, hum, other axes "
                "and noise of a stage at rest are what piezoid diagnose tells.",
            )
    covariance = sum(
        float(np.sum((u - u.mean()) * (y - y.mean())))
        for u, y in zip(drives, (r.displacement_m(axis) for r in recordings), strict=True)
    )
    return Scales(
        voltage_V=(high - low) / 2,
        voltage_offset_V=(high + low) / 2,
        displacement_m=float(np.copysign(max(spans) / 2, covariance)),
    )


def pieces_of(
    recordings: Sequence[Recording], axis: str, scales: Scales, rig: Rig
) -> tuple[Piece, ...]:
    """Cut recordings into scaled pieces, without stretches that are too short."""
    pieces = []
    for number, recording in enumerate(recordings):
        rate_Hz, bridged = recording.sampling_rate_Hz, np.array(recording.bridged, dtype=np.intp)
        scaled_V = (recording.voltage_V(axis) - scales.voltage_offset_V) / scales.voltage_V
        for part in recording.pieces:
            if part.stop - part.start < MINIMUM_SAMPLES:
                continue
            measured_m = recording.displacement_m(axis)[part]
            centre_m = float((measured_m.max() + measured_m.min()) / 2)
            is_inside = (bridged >= part.start) & (bridged < part.stop)
            piece = Piece(
                name=recording.name,
                recording=number,
                sampling_rate_Hz=rate_Hz,
                drive=behind_pole(scaled_V[part], rig.amplifier_bandwidth_Hz, rate_Hz),
                response=(measured_m - centre_m) / scales.displacement_m,
                centre_m=centre_m,
                first=0,
                last=len(measured_m),
                lost=bridged[is_inside] - part.start,
                begin=part.start,
            )
            pieces.append(piece)
    if not pieces:
        raise ExcitationError(
            f"{', '.join(r.name for r in recordings)}: no uninterrupted stretch is longer than "
            f"{MINIMUM_SAMPLES} samples",
            needed="a continuous recording of at least one sweep",
            remedy="Record again without losing samples.",
        )
    return tuple(pieces)


def behind_pole(signal: Array, bandwidth_Hz: float | None, sampling_rate_Hz: float) -> Array:
    """Return a signal, or columns, behind a declared pole, straight between samples; None: as is.

    A recording slower than the converter holds samples of a smooth drive; at the converter's own
    rate the hold's half sample is left to the fitted lag.
    """
    if bandwidth_Hz is None:
        return signal
    return relaxed(signal, 1.0 / (2 * np.pi * bandwidth_Hz), sampling_rate_Hz)
