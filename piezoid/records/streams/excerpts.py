"""Recordings on disk beside each other: compared as those in memory are, by means of blocks.

Means keep the slow part of a drive and its answer, by which gains are told, and of a copy
everything but its printing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.comparison import beside_the_widest, copies, refuse_misfits
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid.records.streams.piece import Piece

SAMPLES = 1 << 16  # of a recording as it is compared, at most
_ROWS = 1 << 17  # that are in memory at one time, about
_LEAST = 2


@dataclass(frozen=True, kw_only=True)
class Compared:
    """What is left to fit of one axis.

    pieces   those of copies left out
    remarks  what was left out, and what is remarkable beside the others
    """

    pieces: tuple[Piece, ...]
    remarks: tuple[str, ...]


def compared(pieces: Sequence[Piece], axis: str, *, samples: int = SAMPLES) -> Compared:
    """Refuse recordings of an axis that do not fit each other, and leave copies out.

    samples  of a recording as it is compared, at most

    Raises ``RecordingError`` as ``refuse_misfits`` does. What goes wrong: of a drive that goes
    through whole periods in every block nothing is left, and its gain is compared to no other.
    """
    whole = [tuple(held) for _, held in groupby(pieces, key=lambda piece: piece.recording)]
    excerpts = [
        made for made in (_excerpt(held, axis, samples) for held in whole) if made is not None
    ]
    refuse_misfits(excerpts)
    again = copies(excerpts)
    remarks = [
        f"{copy} holds the same samples as {original}: it tests nothing that was fitted to "
        f"{original}, and is left out"
        for copy, original in again.items()
    ]
    kept = tuple(piece for piece in pieces if piece.name not in again)
    remarks += [text for _, text in beside_the_widest(_ranges(kept), axis)]
    return Compared(pieces=kept, remarks=tuple(remarks))


def _ranges(pieces: Iterable[Piece]) -> dict[str, tuple[float, float]]:
    found: dict[str, tuple[float, float]] = {}
    for piece in pieces:
        low_V, high_V = found.get(piece.name, piece.voltage_V)
        found[piece.name] = min(low_V, piece.voltage_V[0]), max(high_V, piece.voltage_V[1])
    return found


def _excerpt(pieces: Sequence[Piece], axis: str, samples: int) -> Recording | None:
    """Return a recording as the means of equal blocks, None where it is too short for one."""
    stride = -(-sum(piece.samples for piece in pieces) // samples)
    means = [part for piece in pieces for part in _means(piece, stride)]
    held = np.hstack(means) if means else np.empty((2, 0))
    if held.shape[1] < _LEAST:
        return None
    quantities = (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
    return Recording(
        name=pieces[0].name,
        digest="",
        axis=axis,
        sampling_rate_Hz=pieces[0].sampling_rate_Hz / stride,
        channels=tuple(
            Channel(quantity=quantity, axis=axis, values=values, label=quantity.name.lower())
            for quantity, values in zip(quantities, held, strict=True)
        ),
    )


def _means(piece: Piece, stride: int) -> Iterable[Array]:
    """Yield the means of every ``stride`` samples of drive and displacement, (2, blocks)."""
    rows = max(_ROWS // stride, 1) * stride
    for block in piece.read(rows):
        count = len(block[0]) // stride
        if count:
            held = np.array([values[: count * stride] for values in block])
            yield held.reshape(2, count, stride).mean(axis=2)
