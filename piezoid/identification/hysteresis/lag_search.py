"""The lag before everything else is known: by the error that a quick linear model leaves."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from piezoid.identification.hysteresis.filters import lagged
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.start import ROWS
from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.play import play_blocks

_POLYNOMIAL = (2, 3)


def find_lag(pieces: Sequence[Piece], kind: str, longest_s: float) -> float:
    """Return the lag with the least error of a quick additive model, by global search.

    The quick model is a non-negative sum of plays of the drive, a cubic of the drive and an
    offset per piece; for a given lag it is linear. The error is not convex in the lag, hence
    the derivative-free global search.
    """
    if kind == "none" or longest_s <= 0.0:
        return 0.0
    columns = [_quick_columns(piece) for piece in pieces]

    def error(x: Array) -> float:
        return _quick_error(pieces, columns, kind, float(x[0]) * longest_s)

    share, _ = direct_search(
        error,
        np.array([0.02]),
        (np.zeros(1), np.ones(1)),
        initial_step=0.02,
        max_evaluations=25,
        step_tolerance=1e-5,
        global_evaluations=25,
    )
    return float(share[0]) * longest_s


def _quick_columns(piece: Piece) -> Array:
    threshold = np.linspace(0.0, 0.9, 10)
    u, plays = piece.drive, len(threshold)
    columns = np.empty((len(u), plays + len(_POLYNOMIAL)), order="F")
    for first, states in play_blocks(u, threshold, np.full(plays, u[0])):
        columns[first : first + len(states), :plays] = states
    for place, power in enumerate(_POLYNOMIAL):
        columns[:, plays + place] = u**power
    return columns


def _quick_error(
    pieces: Sequence[Piece], columns: Sequence[Array], kind: str, lag_s: float
) -> float:
    total = 0.0
    for piece, column in zip(pieces, columns, strict=True):
        stride = max(1, piece.rows // ROWS)
        keep, counting = slice(piece.first, piece.last, stride), piece.counting(stride)
        rows = lagged(column, kind, lag_s, piece.sampling_rate_Hz, keep=keep)
        if len(counting) < len(rows):
            rows = rows[(counting - piece.first) // stride]
        triangle = _gathered(_signed(rows, piece.response[counting]))
        total += nnls(triangle[:, :-1], triangle[:, -1])[1] ** 2 / len(rows)
    return total


def _signed(rows: Array, response: Array) -> Array:
    """Return [columns, what may be negative once more, a constant of either sign | response]."""
    count, free = rows.shape[1], len(_POLYNOMIAL)
    block = np.empty((len(rows), count + free + 3), order="F")
    block[:, :count] = rows
    block[:, count : count + free] = -rows[:, -free:]
    block[:, -3], block[:, -2], block[:, -1] = 1.0, -1.0, response
    return block


def _gathered(block: Array) -> Array:
    return gather(empty_triangle(block.shape[1]), block, spend=True)
