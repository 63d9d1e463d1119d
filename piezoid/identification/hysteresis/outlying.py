"""Readings that stand out of a first fit: left out before the fit that counts.

    d[k] = e[k] - median(e[k-4..k+4]),   out where |d| > 8 max(s, local), s = 1.4826 median |d|

What a rough fit does not follow is smooth beside a single wrong reading, so the residual tells it
where the response itself is steep. Where many neighbours stand out as far, it rings: ``local`` is
the 70 % quantile of |d| around. Behind a turn of the drive a rough fit errs by the same every
time: there ``local`` is at least that quantile of |d| at as many samples behind the other turns.
Where the drive moves the stage far within the window, a rough fit errs by a part of that motion:
|d| must exceed a tenth of it as well. [Hampel 1974]
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.search import Fitted, continued
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Samples
from piezoid.records.reversals import noise_of, reversals_of

FAR = 8.0  # times: one of 1e15 normal residuals
WIDTH = 9  # samples of the median, of which four may be wrong
AROUND = 10  # samples on either side that say whether it rings
RINGING = 0.7  # of these
STEEP = 0.8  # of its distance from the median: less is a corner
SOLE = 0.9  # of a pair's, for a corner is three quarters
BEFORE, BEHIND = 2, 8  # samples about a turn in which a law bends as a rough fit does not
TURNS = 3  # so many say what is usual there
MISFIT = 0.1  # of the motion in the window: what a rough fit may miss of it
PASSES = 3  # one of two beside each other may hide the other
MOST = 0.1  # of a piece: more are no outliers


def without_outliers(fitted: Fitted) -> tuple[Piece, ...]:
    """Return the pieces of a fit with single readings that stand out of it counted as lost."""
    return tuple(
        _without(piece, continued(fitted, index, piece) - piece.response)
        for index, piece in enumerate(fitted.task.pieces)
    )


def left_out_of(before: Sequence[Piece], after: Sequence[Piece]) -> tuple[str, ...]:
    """Return one sentence for every piece of which readings were left out."""
    said = []
    for old, new in zip(before, after, strict=True):
        count = len(new.lost) - len(old.lost)
        if count:
            said.append(
                f"{new.name}: {count} single readings ({100 * count / new.rows:.2g} %) that stand "
                "far out of their neighbours and of the fit were left out."
            )
    return tuple(said)


def _without(piece: Piece, error: Array) -> Piece:
    out = outlying(error, piece.drive, piece.response)
    out = out[(out >= piece.first) & (out < piece.last)]
    if not len(out):
        return piece
    lost = np.union1d(piece.lost, out)
    place = np.arange(len(piece.response))
    good = np.setdiff1d(place, lost)
    return replace(
        piece, response=np.interp(place, good, piece.response[good]), lost=lost.astype(np.intp)
    )


def outlying(error: Array, drive: Array, response: Array) -> Samples:
    """Return which samples of a residual stand out of their neighbours, increasing.

    error, drive, response  (samples,)  any unit; the response in that of the error
    """
    lag, motion = _behind_turns(drive), _motion(drive, response)
    good = np.arange(len(error))
    for _ in range(PASSES):
        if len(good) <= 4 * WIDTH:
            break
        fresh = _standing_out(error[good], lag[good], motion[good])
        if not len(fresh):
            break
        good = np.delete(good, fresh)
    return np.setdiff1d(np.arange(len(error)), good)


def _behind_turns(drive: Array) -> Samples:
    """Return how many samples each lies behind a turn; ``BEHIND`` + 1 for those behind none."""
    turns = np.array([0, *reversals_of(drive, noise_of(drive))])
    lag = np.full(len(drive), BEHIND + 1)
    if len(turns) > TURNS:
        for behind in (*range(-BEFORE, 0), *range(BEHIND, -1, -1)):
            place = turns + behind
            lag[place[(place >= 0) & (place < len(drive))]] = behind
    return lag


def _motion(drive: Array, response: Array) -> Array:
    """Return how far the drive moves the stage within the window of every sample, (samples,)."""
    ends = (0.002, 0.998)
    gain = np.ptp(np.quantile(response, ends)) / max(np.ptp(np.quantile(drive, ends)), 1e-300)
    moved = maximum_filter1d(drive, WIDTH) - minimum_filter1d(drive, WIDTH)
    return np.asarray(gain * moved)


def _usual(apart: Array, lag: Samples) -> Array:
    """Return what is usual as many samples behind a turn, 0 elsewhere, (samples,)."""
    usual = np.zeros(len(apart))
    for behind in range(-BEFORE, BEHIND + 1):
        there = lag == behind
        if np.count_nonzero(there) > TURNS:
            usual[there] = np.quantile(apart[there], RINGING)
    return usual


def _standing_out(error: Array, lag: Samples, motion: Array) -> Samples:
    reach = WIDTH // 2
    padded = np.pad(error, reach, mode="reflect", reflect_type="odd")
    apart = np.abs(
        error - np.median(np.lib.stride_tricks.sliding_window_view(padded, WIDTH), axis=1)
    )
    scale = 1.4826 * float(np.median(apart))
    far = np.flatnonzero(apart > np.maximum(FAR * scale, MISFIT * motion))
    if scale == 0.0 or len(far) > MOST * len(error):
        return np.zeros(0, dtype=np.intp)
    near = [apart[max(k - AROUND, 0) : k + AROUND + 1] for k in far.tolist()]
    local = np.array([np.quantile(values, RINGING) for values in near])
    far = far[apart[far] > FAR * np.maximum(local, _usual(apart, lag)[far])]
    return np.asarray(far[_steep(error, far) > STEEP * apart[far]])


def _steep(error: Array, places: Samples) -> Array:
    """Return how far samples, alone or with the one beside them, stand off those next to them.

    At a corner of the residual, where a branch begins that the fit does not follow, a sample
    stands half as far off its two neighbours as off the median of nine, or three quarters off the
    next but one.
    """
    padded = np.pad(error, 2, mode="edge")
    at, off = places + 2, []
    alone = np.abs(padded[at] - 0.5 * (padded[at - 1] + padded[at + 1]))
    for side in (-1, 1):
        pair = padded[at] - 0.5 * (padded[at - side] + padded[at + 2 * side])
        other = padded[at + side] - 0.5 * (padded[at - side] + padded[at + 2 * side])
        both = np.where(pair * other > 0.0, np.minimum(np.abs(pair), np.abs(other)), 0.0)
        off.append(both * SOLE)
    return np.asarray(np.max([alone, *off], axis=0))
