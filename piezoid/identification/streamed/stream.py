"""Stream: one uninterrupted piece in scaled units, read from disk as often as a fit needs it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.errors import ExcitationError
from piezoid.identification.hysteresis.filters import filter_columns, first_order
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece, Rig, Scales
from piezoid.numerics.arrays import Array
from piezoid.records.streams.piece import Piece as Spooled

CHUNK = 8192
SETTLED = 37.0  # time constants after which a filter has forgotten all but rounding
STILL = 0.01  # of the widest drive: a piece that moves less says nothing of hysteresis
MOST = 24  # pieces: each has a zero and a memory of its own


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """One piece on disk, and how its volts and metres are scaled.

    centre_m  subtracted from the displacement
    chunk     samples that are in memory at one time
    """

    held: Spooled
    scales: Scales
    rig: Rig
    centre_m: float
    chunk: int = CHUNK

    @property
    def samples(self) -> int:
        """How many there are."""
        return self.held.samples

    @property
    def rate_Hz(self) -> float:
        """The sampling rate."""
        return self.held.sampling_rate_Hz

    def chunks(self, begin: int = 0, stop: int | None = None) -> Iterator[tuple[Array, Array]]:
        """Yield scaled drive, behind the declared amplifier, and scaled response.

        begin, stop  samples between which they lie; the amplifier has then been followed for as
                     long as it remembers
        """
        bandwidth_Hz = self.rig.amplifier_bandwidth_Hz
        time_s = None if bandwidth_Hz is None else 1.0 / (2 * np.pi * bandwidth_Hz)
        warm = 0 if time_s is None else int(np.ceil(SETTLED * time_s * self.rate_Hz))
        first, state = max(begin - warm, 0), None
        for voltage_V, displacement_m in self.held.read(self.chunk, first, stop):
            drive = (voltage_V - self.scales.voltage_offset_V) / self.scales.voltage_V
            response = (displacement_m - self.centre_m) / self.scales.displacement_m
            if time_s is not None:
                column = drive[:, None]
                state = np.repeat(column[:1], 2, axis=0) if state is None else state
                drive = filter_columns(column, first_order(time_s, self.rate_Hz), state)[:, 0]
            early = max(begin - first, 0)
            first += len(drive)
            if early < len(drive):
                yield drive[early:], response[early:]

    def described(self) -> Piece:
        """Return the piece as the fit's formulas know it: its first sample and its length."""
        drive, response = next(self.chunks())
        return Piece(
            name=self.held.name,
            recording=self.held.recording,
            sampling_rate_Hz=self.rate_Hz,
            drive=drive[:1],
            response=response[:1],
            centre_m=self.centre_m,
            first=0,
            last=self.samples,
        )

    def excerpt(self, samples: int, stride: int) -> Piece:
        """Return the beginning, every ``stride``-th sample of it, as a piece in memory."""
        kept: list[tuple[Array, Array]] = []
        seen = 0
        for drive, response in self.chunks():
            rows = slice(-seen % stride, None, stride)
            kept.append((drive[rows], response[rows]))
            seen += len(drive)
            if seen >= samples * stride:
                break
        drive, response = (np.concatenate(part) for part in zip(*kept, strict=True))
        return replace(
            self.described(),
            sampling_rate_Hz=self.rate_Hz / stride,
            drive=drive[:samples],
            response=response[:samples],
            last=len(drive[:samples]),
        )


def streams_of(
    held: Sequence[Spooled], axis: str, rig: Rig, chunk: int = CHUNK
) -> tuple[Stream, ...]:
    """Return the pieces that say something of an axis, the longest ``MOST`` of them.

    Raises ``ExcitationError`` where the drive or the displacement does not move, and where every
    stretch is too short.
    """
    widest = max(high - low for low, high in (p.voltage_V for p in held))
    moving = [p for p in held if np.ptp(p.voltage_V) > STILL * widest] or list(held)
    scales = _scales(moving, axis)
    long = [p for p in moving if p.samples >= MINIMUM_SAMPLES]
    if not long:
        raise ExcitationError(
            f"{', '.join(sorted({p.name for p in held}))}: no uninterrupted stretch is longer "
            f"than {MINIMUM_SAMPLES} samples",
            needed="a continuous recording of at least one sweep",
            remedy="Record again without losing samples.",
        )
    least = sorted((p.samples for p in long), reverse=True)[:MOST][-1]
    return tuple(
        Stream(
            held=piece,
            scales=scales,
            rig=rig,
            centre_m=(piece.displacement_m[0] + piece.displacement_m[1]) / 2,
            chunk=chunk,
        )
        for piece in [p for p in long if p.samples >= least][:MOST]
    )


def _scales(held: Sequence[Spooled], axis: str) -> Scales:
    low, high = min(p.voltage_V[0] for p in held), max(p.voltage_V[1] for p in held)
    numbers = sorted({p.recording for p in held})
    spans = [_span([p for p in held if p.recording == number]) for number in numbers]
    for what, span in (("drive", high - low), ("displacement", max(spans))):
        if span <= 0.0:
            raise ExcitationError(
                f"{', '.join(sorted({p.name for p in held}))}: the {what} of axis {axis} never "
                "changes",
                needed="a sweep over the range the stage is used in",
                remedy="Check which column is which, or record a sweep.",
            )
    return Scales(
        voltage_V=(high - low) / 2,
        voltage_offset_V=(high + low) / 2,
        displacement_m=float(np.copysign(max(spans) / 2, sum(p.covariance for p in held))),
    )


def _span(held: Sequence[Spooled]) -> float:
    return max(p.displacement_m[1] for p in held) - min(p.displacement_m[0] for p in held)
