"""What lies before the forgetting time: kept while it can be explained, left out when it cannot.

Every play forgets its initial state once the drive's range has reached twice its threshold. Until
then the output depends on a past nobody recorded. An admissible initial memory explains most of
it; a transient from before the record (a step just before, a controller that was switched on)
does not, and would corrupt the weights.
"""

from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece
from piezoid.identification.hysteresis.search import Fitted, continued
from piezoid.operators.play import forgetting_sample

MISFIT = 3.0  # times the rms of what comes later


@dataclass(frozen=True, kw_only=True)
class Transient:
    """A stretch left out of a fit.

    piece      index of the piece
    rows       how many samples at its beginning were left out
    misfit     their rms residual over that of the rows behind them
    """

    piece: int
    rows: int
    misfit: float


def without_transients(fitted: Fitted) -> tuple[tuple[Piece, ...], tuple[Transient, ...]]:
    """Return the pieces with beginnings left out that no admissible memory explains."""
    pieces, transients = [], []
    for index, piece in enumerate(fitted.task.pieces):
        found = _transient(fitted, index, piece)
        if found is None:
            pieces.append(piece)
        else:
            transients.append(found)
            pieces.append(replace(piece, first=piece.first + found.rows))
    return tuple(pieces), tuple(transients)


def _transient(fitted: Fitted, index: int, piece: Piece) -> Transient | None:
    moving = fitted.operator.threshold
    if moving.size == 0:
        return None
    drive = piece.drive[piece.first : piece.last]
    forgotten = int(forgetting_sample(drive, moving).max())
    if forgotten < 2 or piece.rows - forgotten < max(MINIMUM_SAMPLES, piece.rows // 3):
        return None
    error = (continued(fitted, index, piece) - piece.response)[piece.first : piece.last]
    error[piece.lost[(piece.lost >= piece.first) & (piece.lost < piece.last)] - piece.first] = 0.0
    before = float(np.sqrt(np.mean(error[:forgotten] ** 2)))
    after = float(np.sqrt(np.mean(error[forgotten:] ** 2)))
    if before <= MISFIT * after:
        return None
    return Transient(piece=index, rows=forgotten, misfit=before / after)
