"""Tracks: recordings in scaled units, with the fitted rows and their blocks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezoid.identification.hysteresis.pieces import (
    Piece,
    Rig,
    Scales,
    behind_pole,
    pieces_of,
)
from piezoid.numerics.arrays import Array, frozen, spread_rows
from piezoid.numerics.executor import Once
from piezoid.operators.filters import later
from piezoid.operators.linear import recursive_filter
from piezoid.operators.play import thinned_drive
from piezoid.records.recording import Quantity, Recording

ROWS = 12_000  # of all tracks together
BLOCKS = 15  # of one track
SETTLING = 7.0  # time constants of declared poles, to a thousandth
REVERSIBLE = 0.03  # of half the drive's range: distance from a reversal in which no wall moves
MAX_BRANCH = 4000  # samples in which a branch must cover this distance
MAX_REVERSALS = 60  # of one track, or up to twice as many

Places = NDArray[np.int_]
EQUAL_RATE = 0.01  # relative difference of a sampling rate from the clock of the converter
MIN_POLE_DISTANCE = 1e-4  # of a pole: closer poles are moved apart


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """An uninterrupted segment of a recording of one axis, in scaled units.

    name          of the recording
    rate_Hz       sampling rate
    command       (samples,)  drive at the ceramic, about -1 to 1 over the range of all tracks
    drive         (samples,)  command behind the declared pole of the sensor, which commutes with
                  hysteresis but not with limits of the amplifier
    sensor_Hz     pole of the sensor; None if it is not declared
    response      (samples,)  displacement over half the stroke, without its middle; it rises with
                  the drive
    other_drives  scaled drives of other axes that move, by axis
    rows          (rows,)     samples that are fitted
    block         (rows,)     block of each row, from 0
    bridged       (count,)    samples that were not measured and are not among ``rows``
    """

    name: str
    rate_Hz: float
    command: Array
    drive: Array
    sensor_Hz: float | None
    response: Array
    other_drives: Mapping[str, Array]
    rows: Places
    block: Places
    bridged: Places = field(default_factory=lambda: np.zeros(0, dtype=int))

    def __post_init__(self) -> None:
        object.__setattr__(self, "command", frozen(self.command, "command"))
        object.__setattr__(self, "drive", frozen(self.drive, "drive"))
        object.__setattr__(self, "response", frozen(self.response, "response"))

    def read(self, command: Array) -> Array:
        """Return the drive of another command, whose change is linear between samples."""
        if command is self.command:
            return self.drive
        return self.drive + behind_pole(command - self.command, self.sensor_Hz, self.rate_Hz)

    @property
    def measured(self) -> Array:
        """Return the response without bridged samples."""
        return np.delete(self.response, self.bridged) if len(self.bridged) else self.response

    @Once
    def branches(self) -> tuple[Places, Places]:
        """Return reversals of the drive, and the samples at the distance ``REVERSIBLE`` from each.

        A reversal without such a sample is left out.
        """
        step = np.sign(np.diff(self.drive))
        reversals = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
        pairs = []
        for reversal in reversals[:: max(len(reversals) // MAX_REVERSALS, 1)].tolist():
            branch = self.drive[reversal : reversal + MAX_BRANCH]
            distant = np.flatnonzero(np.abs(branch - branch[0]) > REVERSIBLE)
            if len(distant):
                pairs.append((reversal, reversal + int(distant[0])))
        starts, ends = np.array(pairs, dtype=int).reshape(-1, 2).T
        return starts, ends

    @Once
    def path(self) -> tuple[Array, Places]:
        """Return the drive thinned to its reversals and rows, and the rows in it."""
        return thinned_drive(self.drive, self.rows)

    @property
    def time_s(self) -> Array:
        """Time of every sample from the first."""
        return np.arange(len(self.drive)) / self.rate_Hz

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last."""
        return (len(self.drive) - 1) / self.rate_Hz


def tracks_of(
    recordings: Sequence[Recording],
    axis: str,
    scales: Scales,
    rig: Rig,
    *,
    clock_Hz: float | None = None,
) -> tuple[Track, ...]:
    """Return the tracks of recordings of one axis, with about ``ROWS`` rows in all.

    clock_Hz  of the converter, if declared: it holds every value for one period, which delays the
              drive of slower recordings by half a period
    """
    pieces = pieces_of(recordings, axis, scales, rig)
    commanded = pieces_of(recordings, axis, scales, Rig())
    # the simulation of declared poles starts at rest, but the drive may move before
    poles_Hz = (rig.amplifier_bandwidth_Hz, rig.sensor_bandwidth_Hz)
    slowest_s = sum(1.0 / (2.0 * np.pi * pole_Hz) for pole_Hz in poles_Hz if pole_Hz)
    share = ROWS // len(pieces)
    starts: dict[int, int] = {}
    tracks = []
    for piece, unfiltered in zip(pieces, commanded, strict=True):
        recording = recordings[piece.recording]
        samples, earliest = len(piece.drive), starts.get(piece.recording, 0)
        first = next(
            int(p.start)
            for p in recording.pieces
            if p.stop - p.start == samples and p.start >= earliest
        )
        starts[piece.recording] = first + samples
        bridged = np.array(recording.bridged, dtype=int) - first
        bridged = bridged[(bridged >= 0) & (bridged < samples)]
        rows = np.setdiff1d(spread_rows(samples, share), bridged)
        settled = int(np.ceil(SETTLING * slowest_s * piece.sampling_rate_Hz))
        rows = rows[rows >= min(settled, samples // 10)]
        other_drives = {
            channel.axis: 2.0
            * (channel.values[first : first + samples] - channel.values.min())
            / float(np.ptp(channel.values))
            - 1.0
            for channel in recording.channels
            if channel.quantity is Quantity.VOLTAGE
            and channel.axis != axis
            and np.ptp(channel.values) > 0.0
        }
        command, drive = _command_and_drive(piece, unfiltered, rig, clock_Hz)
        tracks.append(
            Track(
                name=piece.name,
                rate_Hz=piece.sampling_rate_Hz,
                command=command,
                drive=drive,
                sensor_Hz=rig.sensor_bandwidth_Hz,
                response=piece.response,
                other_drives=other_drives,
                rows=rows,
                block=rows * BLOCKS // samples,
                bridged=bridged,
            )
        )
    return tuple(tracks)


def _command_and_drive(
    piece: Piece, unfiltered: Piece, rig: Rig, clock_Hz: float | None
) -> tuple[Array, Array]:
    """Return the drive at the ceramic, and the same drive behind the pole of the sensor.

    piece       drive behind the pole of the amplifier, linear between samples
    unfiltered  drive in front of this pole
    """
    rate_Hz = piece.sampling_rate_Hz
    amplifier_Hz, sensor_Hz = rig.amplifier_bandwidth_Hz, rig.sensor_bandwidth_Hz
    has_bandwidth = amplifier_Hz is not None or sensor_Hz is not None
    if has_bandwidth and clock_Hz is not None and abs(rate_Hz / clock_Hz - 1.0) < EQUAL_RATE:
        # samples are values of the converter, which holds them
        ceramic = staircase_response(unfiltered.drive, (amplifier_Hz,), rate_Hz)
        return ceramic, staircase_response(unfiltered.drive, (amplifier_Hz, sensor_Hz), rate_Hz)
    delay = 0.0 if clock_Hz is None else 0.5 * rate_Hz / clock_Hz
    command = later(piece.drive, delay) if delay else piece.drive
    return command, behind_pole(command, sensor_Hz, rate_Hz)


def staircase_response(
    command: Array, poles_Hz: tuple[float | None, ...], rate_Hz: float
) -> Array:
    """Return the response of up to two poles to a zero-order hold, at its samples.

    At the rate of the converter a command is a staircase. Two poles give at the next sample

        y[k] = sum_i c_i h_i[k],  h_i[k] = p_i h_i[k-1] + (1 - p_i) u[k-1],  p_i = exp(-w_i T),
        c_1 = w_2 / (w_2 - w_1),  c_2 = -w_1 / (w_2 - w_1),

    A drive that is linear between samples would be 2 % off at 13 samples per period.

    Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems (1998), step invariance.
    """
    rates = [2.0 * np.pi * pole for pole in poles_Hz if pole is not None]
    if not rates:
        return np.concatenate([command[:1], command[:-1]])
    if len(rates) == 1:
        return _behind(command, rates[0] / rate_Hz)
    first, second = rates
    if abs(second / first - 1.0) < MIN_POLE_DISTANCE:
        second = first * (1.0 + MIN_POLE_DISTANCE)
    share = second / (second - first)
    return np.asarray(
        share * _behind(command, first / rate_Hz)
        + (1.0 - share) * _behind(command, second / rate_Hz)
    )


def _behind(command: Array, ratio: float) -> Array:
    pole = float(np.exp(-ratio))
    response = recursive_filter([0.0, 1.0 - pole], [1.0, -pole], command - command[0])
    return np.asarray(response + command[0])
