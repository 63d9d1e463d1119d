"""Recordings as the joint fit sees them: pieces, the rows that count, the blocks they form.

Rows lie at no one distance, so that no hum hides between them. Blocks are stretches of several
seconds, or sixths of a short piece. Of the first block of each piece, every other quarter is never
left out: nothing else tells the memory and the zero with which the piece begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.extensions.extension import Samples, Where
from piezoid.identification.hysteresis.pieces import Piece, Scales, pieces_of
from piezoid.identification.model import AxisModel, PieceStart
from piezoid.identification.simulation import where_of
from piezoid.records.recording import Recording

ROWS = 12_000  # of all pieces together
FOLDS = 5
FEWEST, MOST = 6, 15  # blocks of a piece
BLOCK_s = 4.0
KEPT = -1  # the fold of blocks that are never left out


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One piece with its rows.

    piece  in scaled units, behind the declared amplifier
    where  the same for extensions
    place  (rows,)  samples that count
    fold   (rows,)  in which fold each is left out, KEPT where in none
    start  how the model says it began, None where the model does not know it
    """

    piece: Piece
    where: Where
    place: Samples
    fold: Samples
    start: PieceStart | None


def scales_from(model: AxisModel) -> Scales:
    """Return the scales in which the numbers of a fitted model are of order one."""
    hysteresis = model.hysteresis
    knots, bends = hysteresis.envelope.threshold, hysteresis.envelope.zero
    low, high = model.voltage_V
    # The kinks of an envelope stand at even places of the scaled drive.
    half_V = float(knots[-1]) * (bends + 1) / bends if bends else (high - low) / 2
    return Scales(
        voltage_V=half_V,
        voltage_offset_V=hysteresis.voltage_offset_V,
        displacement_m=model.polarity * model.quality.range_m / 2,
    )


def parts_of(
    model: AxisModel,
    recordings: Sequence[Recording],
    places: Sequence[Samples] | None = None,
) -> list[Part]:
    """Cut recordings into parts; those the model knows begin as it says.

    places  samples that may count, piece by piece; None chooses them
    """
    pieces = pieces_of(recordings, model.axis, scales_from(model), model.rig)
    share = max(ROWS // len(pieces), 50)
    known = {name: [s for s in model.starts if s.recording == name] for name in _names(model)}
    ends = {k: _slices(recording, pieces, k) for k, recording in enumerate(recordings)}
    parts = []
    for number, piece in enumerate(pieces):
        recording = recordings[piece.recording]
        starts = known.get(recording.name, [])
        fits = len(starts) == sum(p.recording == piece.recording for p in pieces)
        start = starts.pop(0) if fits and starts else None
        if start is not None:
            piece = replace(piece, first=start.first, last=start.last)
            known[recording.name] = starts
        where = where_of(recording, model.axis, ends[piece.recording].pop(0))
        place = _rows(piece, share) if places is None else _within(piece, places[number])
        parts.append(
            Part(
                piece=piece,
                where=where,
                place=place,
                fold=_folds(piece, place, number),
                start=start,
            )
        )
    return parts


def _names(model: AxisModel) -> set[str]:
    return {start.recording for start in model.starts}


def _slices(recording: Recording, pieces: Sequence[Piece], number: int) -> list[slice]:
    lengths = [len(piece.drive) for piece in pieces if piece.recording == number]
    found: list[slice] = []
    for part in recording.pieces:
        if len(found) < len(lengths) and part.stop - part.start == lengths[len(found)]:
            found.append(part)
    return found


def _rows(piece: Piece, share: int) -> Samples:
    if piece.rows <= share:
        return piece.counting()
    spread = np.random.default_rng(piece.rows).random(share)
    steps = (np.arange(share) + spread) * (piece.rows / share)
    return np.setdiff1d(np.unique(steps.astype(int)) + piece.first, piece.lost)


def _within(piece: Piece, place: Samples) -> Samples:
    return np.setdiff1d(place[(place >= piece.first) & (place < piece.last)], piece.lost)


def _folds(piece: Piece, place: Samples, number: int) -> Samples:
    duration_s = piece.rows / piece.sampling_rate_Hz
    blocks = int(np.clip(duration_s / BLOCK_s, FEWEST, MOST))
    quarter = (place - piece.first) * blocks * 4 // piece.rows
    first = np.where(quarter % 2 == 0, KEPT, (quarter + number) % FOLDS)
    return np.where(quarter < 4, first, (quarter // 4 + number) % FOLDS)
