"""Uninterrupted pieces of recordings: scaled drive and displacement, and their fitted starts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError
from piezoid.identification.extensions.extension import Where
from piezoid.numerics.arrays import Array, Samples, freeze
from piezoid.numerics.executor import Once
from piezoid.operators.filters import relaxed
from piezoid.operators.play import turns_of
from piezoid.records.drive_signal import is_at_rest, noise_of, reversals_of
from piezoid.records.recording import Quantity, Recording

MINIMUM_SAMPLES = 20
MIN_DRIFT = 5e-4  # of the range: a smaller drift of the zero does not matter to a controller
# Drift over the residual: the zero also follows unmodelled hysteresis. On healthy recordings of
# seven laws it drifted by 0.01 to 3.1 times the residual, with a drift of 1 % by 16 times.
MIN_RATIO = 4.0


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
    """Scales that convert volts and metres to values of order one.

    voltage_V        half the range of the drive
    voltage_offset_V middle of the range of the drive
    displacement_m   half the range of the displacement, negative if it falls as the drive rises
    """

    voltage_V: float
    voltage_offset_V: float
    displacement_m: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """One uninterrupted piece of a recording.

    name              of the recording
    recording         its index among the recordings of the fit
    sampling_rate_Hz  > 0
    drive             (samples,)  scaled, behind the declared amplifier
    response          (samples,)  scaled, about zero
    centre_m          displacement that was subtracted before scaling
    first, last       range of the fitted rows; states are computed from sample 0 in any case
    invalid           (count,)  samples without a valid measurement, which are not fitted
    begin             sample of the recording at which the piece begins
    others_V          drives of other axes by axis, (samples,)
    """

    name: str
    recording: int
    sampling_rate_Hz: float
    drive: Array
    response: Array
    centre_m: float
    first: int
    last: int
    invalid: Samples = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    begin: int = 0
    others_V: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze(self, "drive", "response")

    @Once
    def turns(self) -> NDArray[np.bool_]:
        """Whether a sample of the drive is the first or a reversal, (samples,)."""
        return turns_of(self.drive)

    @property
    def where(self) -> Where:
        """Location of the piece, for extensions."""
        return Where(
            recording=self.name,
            rate_Hz=self.sampling_rate_Hz,
            first=self.begin,
            samples=len(self.drive),
            others_V=self.others_V,
        )

    @property
    def rows(self) -> int:
        """Number of samples in the range of the fitted rows, invalid ones included."""
        return self.last - self.first

    @property
    def fitted_drive(self) -> Array:
        """Drive of the fitted rows, (rows,)."""
        return self.drive[self.first : self.last]

    @property
    def fitted_response(self) -> Array:
        """Response of the fitted rows, (rows,)."""
        return self.response[self.first : self.last]

    def fitted_samples(self, stride: int = 1) -> Samples:
        """Return every ``stride``-th of the fitted samples, without invalid ones, (rows,)."""
        sample = np.arange(self.first, self.last, stride)
        if not len(self.invalid):
            return sample
        return np.setdiff1d(sample, self.invalid, assume_unique=True)


def response_range(pieces: Sequence[Piece]) -> float:
    """Return the largest range of the response in one piece."""
    return max(float(np.ptp(piece.fitted_response)) for piece in pieces)


def cycle_edges(drive: Array, blocks: int) -> Samples:
    """Return the edges of blocks of whole cycles, from one rise through the middle to another.

    drive     (samples,)
    returned  (edges,)  0 to samples; with fewer cycles than blocks, blocks of equal length
    """
    edges = np.linspace(0, len(drive), blocks + 1).astype(int)
    is_above = drive >= 0.5 * (drive.max() + drive.min())
    rises = 1 + np.flatnonzero(~is_above[:-1] & is_above[1:])
    if len(rises) < blocks:
        return edges
    nearest = rises[np.abs(rises[:, None] - edges[1:-1]).argmin(axis=0)]
    return np.unique(np.concatenate([edges[:1], nearest, edges[-1:]]))


def widest_swing(pieces: Sequence[Piece]) -> tuple[float, float]:
    """Return minimum and maximum of the drive in the piece with the largest range."""
    drives = [piece.drive[: piece.last] for piece in pieces]
    widest = max(drives, key=lambda drive: float(np.ptp(drive)))
    return float(widest.min()), float(widest.max())


def longest_lag_s(pieces: Sequence[Piece]) -> float:
    """Return the upper bound of the lag: a quarter of the duration of the slower branches."""
    branches = []
    for piece in pieces:
        reversals = reversals_of(piece.drive, max(noise_of(piece.drive), 0.02))
        edges = np.array([piece.first, *reversals, piece.last])
        branches.extend((np.diff(edges) / piece.sampling_rate_Hz).tolist())
    ten_samples_s = 10.0 / min(piece.sampling_rate_Hz for piece in pieces)
    return max(ten_samples_s, 0.25 * float(np.quantile(branches, 0.9)))


def scales_of(recordings: Sequence[Recording], axis: str) -> Scales:
    """Return the common scales of recordings of one axis.

    Raises ``ExcitationError`` if the drive or the displacement does not move.
    """
    drives = [recording.voltage_V(axis) for recording in recordings]
    responses = [recording.displacement_m(axis) for recording in recordings]
    is_constant = all(map(is_at_rest, drives, responses))
    low, high = min(float(u.min()) for u in drives), max(float(u.max()) for u in drives)
    spans = [float(np.ptp(response)) for response in responses]
    names = ", ".join(recording.name for recording in recordings)
    noise = " but for the noise of its reading" if high > low else ""
    for finding, applies in (
        (f"drive of axis {axis} never changes{noise}", is_constant),
        (f"displacement of axis {axis} never changes", max(spans) <= 0.0),
    ):
        if applies:
            raise ExcitationError(
                f"{names}: the {finding}",
                needed="a sweep over the range in which the stage is used",
                remedy="Check which column is which, or record a sweep. piezoid diagnose reports "
                "drift, hum, coupling and noise of a stage at rest.",
            )
    covariance = sum(
        float(np.sum((u - u.mean()) * (y - y.mean())))
        for u, y in zip(drives, responses, strict=True)
    )
    return Scales(
        voltage_V=(high - low) / 2,
        voltage_offset_V=(high + low) / 2,
        displacement_m=float(np.copysign(max(spans) / 2, covariance)),
    )


def pieces_of(
    recordings: Sequence[Recording], axis: str, scales: Scales, rig: Rig
) -> tuple[Piece, ...]:
    """Cut recordings into scaled pieces, without pieces that are too short."""
    pieces = []
    for number, recording in enumerate(recordings):
        rate_Hz, bridged = recording.sampling_rate_Hz, np.array(recording.bridged, dtype=np.intp)
        scaled_V = (recording.voltage_V(axis) - scales.voltage_offset_V) / scales.voltage_V
        for rows in recording.pieces:
            if rows.stop - rows.start < MINIMUM_SAMPLES:
                continue
            measured_m = recording.displacement_m(axis)[rows]
            centre_m = float((measured_m.max() + measured_m.min()) / 2)
            is_inside = (bridged >= rows.start) & (bridged < rows.stop)
            piece = Piece(
                name=recording.name,
                recording=number,
                sampling_rate_Hz=rate_Hz,
                drive=behind_pole(scaled_V[rows], rig.amplifier_bandwidth_Hz, rate_Hz),
                response=(measured_m - centre_m) / scales.displacement_m,
                centre_m=centre_m,
                first=0,
                last=len(measured_m),
                invalid=bridged[is_inside] - rows.start,
                begin=rows.start,
                others_V=where_of(recording, axis, rows).others_V,
            )
            pieces.append(piece)
    if not pieces:
        raise ExcitationError(
            f"{', '.join(r.name for r in recordings)}: no uninterrupted piece is longer than "
            f"{MINIMUM_SAMPLES} samples",
            needed="a continuous recording of at least one sweep",
            remedy="Record again without losing samples.",
        )
    return tuple(pieces)


def where_of(recording: Recording, axis: str, rows: slice) -> Where:
    """Return the location of some rows for extensions, with the drives of other axes that move."""
    other_drives = {
        channel.axis: channel.values[rows]
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE
        and channel.axis != axis
        and np.ptp(channel.values) > 0.0
    }
    return Where(
        recording=recording.name,
        rate_Hz=recording.sampling_rate_Hz,
        first=rows.start,
        samples=rows.stop - rows.start,
        others_V=other_drives,
    )


def behind_pole(signal: Array, bandwidth_Hz: float | None, sampling_rate_Hz: float) -> Array:
    """Filter a signal or columns, linear between samples, by a declared pole; None: no pole.

    A recording slower than the converter contains samples of a smooth drive. At the rate of the
    converter, the fitted lag contains the half sample of the hold.
    """
    if bandwidth_Hz is None:
        return signal
    return relaxed(signal, 1.0 / (2 * np.pi * bandwidth_Hz), sampling_rate_Hz)


@dataclass(frozen=True, kw_only=True, eq=False)
class PieceStart:
    """Initial state and zero of one uninterrupted piece of a recording.

    recording       name of the recording
    memory_V        (plays,)  admissible states of u - u_off before the first sample
    zero_m          (knots,)  displacement at output 0 of the operator, equidistant over the rows
    first, last     first fitted sample of the piece, and the sample after the last
    history_weight  (histories,)  weights of ``AxisModel.history_changes_m``; empty: 0
    """

    recording: str
    memory_V: Array
    zero_m: Array
    first: int
    last: int
    history_weight: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        freeze(self, "memory_V", "zero_m", "history_weight")


def drifting_zeros(
    starts: Sequence[PieceStart], rms_m: float, range_m: float
) -> tuple[tuple[PieceStart, float], ...]:
    """Return the pieces whose zero drifts significantly, each with its drift in m.

    rms_m    residual of the fit
    range_m  of the displacement
    """
    min_drift_m = max(MIN_DRIFT * range_m, MIN_RATIO * rms_m)
    drifts = [(start, float(np.ptp(start.zero_m))) for start in starts]
    return tuple((start, drift_m) for start, drift_m in drifts if drift_m > min_drift_m)
