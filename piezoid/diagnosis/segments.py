"""Tracks: recordings in scaled units, with the rows that are compared and the blocks they form."""

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
from piezoid.numerics.arrays import Array, frozen
from piezoid.numerics.executor import Once
from piezoid.operators.filters import later
from piezoid.operators.linear import recursive_filter
from piezoid.operators.play import way_to
from piezoid.records.recording import Quantity, Recording

ROWS = 12_000  # of all tracks together
BLOCKS = 15  # of one track
FORGOTTEN = 7.0  # time constants of declared poles, to a thousandth
TURN = 0.03  # of half the drive's range: how far a branch is still reversible,
LONGEST = 4000  # samples that may take it
MOST_TURNS = 60  # or twice as many, of one track

Places = NDArray[np.int_]
SAME = 0.01  # of the clock: so near a recording's rate is the converter's own
APART = 1e-4  # of a pole: nearer ones are one


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """One uninterrupted stretch of one recording of one axis.

    name      of the recording
    rate_Hz   sampling rate
    command   (samples,)  about -1 to 1 over the range of all tracks, at the ceramic
    drive     (samples,)  the same behind the sensor's declared pole, which commutes with
                          hysteresis but not with limits of the amplifier
    sensor_Hz             that pole, None where it is not declared
    response  (samples,)  displacement over half the stroke, without its middle; it rises with
                          the drive
    others    scaled drives of other axes that move, by axis
    place     (rows,)     samples that are compared
    block     (rows,)     block of each of these, from 0
    bridged   (count,)    samples that were never measured: they are not among ``place``
    """

    name: str
    rate_Hz: float
    command: Array
    drive: Array
    sensor_Hz: float | None
    response: Array
    others: Mapping[str, Array]
    place: Places
    block: Places
    bridged: Places = field(default_factory=lambda: np.zeros(0, dtype=int))

    def __post_init__(self) -> None:
        object.__setattr__(self, "command", frozen(self.command, "command"))
        object.__setattr__(self, "drive", frozen(self.drive, "drive"))
        object.__setattr__(self, "response", frozen(self.response, "response"))

    def read(self, command: Array) -> Array:
        """Return another command behind the sensor's pole, the change straight between samples."""
        if command is self.command:
            return self.drive
        return self.drive + behind_pole(command - self.command, self.sensor_Hz, self.rate_Hz)

    @property
    def measured(self) -> Array:
        """Return the response without what was bridged."""
        return np.delete(self.response, self.bridged) if len(self.bridged) else self.response

    @Once
    def branches(self) -> tuple[Places, Places]:
        """Return where the drive turns, and where it has come ``TURN`` away from there."""
        step = np.sign(np.diff(self.drive))
        reversals = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
        found = []
        for turn in reversals[:: max(len(reversals) // MOST_TURNS, 1)].tolist():
            after = self.drive[turn : turn + LONGEST]
            state = np.flatnonzero(np.abs(after - after[0]) > TURN)
            if len(state):
                found.append((turn, turn + int(state[0])))
        turn, there = np.array(found, dtype=int).reshape(-1, 2).T
        return turn, there

    @Once
    def way(self) -> tuple[Array, Places]:
        """Return the drive where it says all of its way to the rows, and the rows in that."""
        return way_to(self.drive, self.place)

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
    """Cut recordings of one axis into tracks with some ``ROWS`` rows in all.

    clock_Hz  of the converter, where it is declared: it holds every value for one period, which
              is half a period of delay in recordings that are slower
    """
    pieces = pieces_of(recordings, axis, scales, rig)
    asked = pieces_of(recordings, axis, scales, Rig())
    share = ROWS // len(pieces)
    starts: dict[int, int] = {}
    tracks = []
    for piece, plain in zip(pieces, asked, strict=True):
        recording = recordings[piece.recording]
        first = _first(recording, len(piece.drive), starts.get(piece.recording, 0))
        starts[piece.recording] = first + len(piece.drive)
        bridged = np.array(recording.bridged, dtype=int) - first
        bridged = bridged[(bridged >= 0) & (bridged < len(piece.drive))]
        place = np.setdiff1d(rows_between(len(piece.drive), share), bridged)
        place = place[place >= _settled(piece, rig)]
        command, drive = _reaching(piece, plain, rig, clock_Hz)
        tracks.append(
            Track(
                name=piece.name,
                rate_Hz=piece.sampling_rate_Hz,
                command=command,
                drive=drive,
                sensor_Hz=rig.sensor_bandwidth_Hz,
                response=piece.response,
                others=_others(recording, axis, first, len(piece.drive)),
                place=place,
                block=place * BLOCKS // len(piece.drive),
                bridged=bridged,
            )
        )
    return tuple(tracks)


def _settled(piece: Piece, rig: Rig) -> int:
    """Return from which sample on poles have forgotten how fast the drive was before the first.

    They begin as if it had rested, and it may have run already.
    """
    poles_Hz = (rig.amplifier_bandwidth_Hz, rig.sensor_bandwidth_Hz)
    slowest_s = sum(1.0 / (2.0 * np.pi * pole_Hz) for pole_Hz in poles_Hz if pole_Hz)
    samples = int(np.ceil(FORGOTTEN * slowest_s * piece.sampling_rate_Hz))
    return min(samples, len(piece.drive) // 10)


def _reaching(piece: Piece, asked: Piece, rig: Rig, clock_Hz: float | None) -> tuple[Array, Array]:
    """Return what reaches the ceramic, and the same behind the sensor's pole.

    piece  behind the amplifier's pole as a line between samples
    asked  in front of it
    """
    rate_Hz = piece.sampling_rate_Hz
    amplifier_Hz, sensor_Hz = rig.amplifier_bandwidth_Hz, rig.sensor_bandwidth_Hz
    if is_held(rate_Hz, clock_Hz, rig):
        ceramic = held(asked.drive, (amplifier_Hz,), rate_Hz)
        return ceramic, held(asked.drive, (amplifier_Hz, sensor_Hz), rate_Hz)
    delay = 0.0 if clock_Hz is None else 0.5 * rate_Hz / clock_Hz
    command = later(piece.drive, delay) if delay else piece.drive
    return command, behind_pole(command, sensor_Hz, rate_Hz)


def rows_between(samples: int, share: int) -> Places:
    """Return rows spread over a track: evenly on average, at no one distance.

    Rows at a fixed distance would show a hum of the grid at another frequency.
    """
    if samples <= share:
        return np.arange(samples)
    spread = np.random.default_rng(samples).random(share)
    return np.unique(((np.arange(share) + spread) * (samples / share)).astype(int))


def _first(recording: Recording, samples: int, after: int) -> int:
    starts = [int(p.start) for p in recording.pieces if p.stop - p.start == samples]
    return next(start for start in starts if start >= after)


def _others(recording: Recording, axis: str, first: int, samples: int) -> dict[str, Array]:
    found = {}
    for channel in recording.channels:
        if channel.quantity is not Quantity.VOLTAGE or channel.axis == axis:
            continue
        values = channel.values
        span = float(np.ptp(values))
        if span > 0.0:
            part = values[first : first + samples]
            found[channel.axis] = np.asarray(2.0 * (part - values.min()) / span - 1.0)
    return found


def is_held(rate_Hz: float, clock_Hz: float | None, rig: Rig) -> bool:
    """Tell whether rows are the converter's own values and a pole of the chain is known."""
    known = rig.amplifier_bandwidth_Hz is not None or rig.sensor_bandwidth_Hz is not None
    return known and clock_Hz is not None and abs(rate_Hz / clock_Hz - 1.0) < SAME


def held(command: Array, poles_Hz: tuple[float | None, ...], rate_Hz: float) -> Array:
    """Return a staircase behind up to two poles, at its own samples.

    At the converter's own rate a command is a staircase, and at the next sample two poles make

        y[k] = sum_i c_i h_i[k],  h_i[k] = p_i h_i[k-1] + (1 - p_i) u[k-1],  p_i = exp(-w_i T),
        c_1 = w_2 / (w_2 - w_1),  c_2 = -w_1 / (w_2 - w_1),

    which no line between samples knows: it is 2 per cent off where a period has 13 samples.

    Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems (1998), step invariance.
    """
    rates = [2.0 * np.pi * pole for pole in poles_Hz if pole is not None]
    if not rates:
        return np.concatenate([command[:1], command[:-1]])
    if len(rates) == 1:
        return _behind(command, rates[0] / rate_Hz)
    first, second = rates
    if abs(second / first - 1.0) < APART:
        second = first * (1.0 + APART)
    share = second / (second - first)
    return np.asarray(
        share * _behind(command, first / rate_Hz)
        + (1.0 - share) * _behind(command, second / rate_Hz)
    )


def _behind(command: Array, ratio: float) -> Array:
    pole = float(np.exp(-ratio))
    moved = recursive_filter([0.0, 1.0 - pole], [1.0, -pole], command - command[0])
    return np.asarray(moved + command[0])
