"""Rows excluded from a fit: single outliers, and initial transients without a fitting memory.

    d[k] = e[k] - median(e[k-4..k+4]),   out where |d| > 8 max(s, local), s = 1.4826 median |d|

What a rough fit does not follow is smooth beside a single wrong reading, so the residual tells it
where the response itself is steep. Where many neighbours stand out as far, it rings: ``local`` is
the 70 % quantile of |d| around. Behind a turn of the drive a rough fit errs by the same every
time: there ``local`` is at least that quantile of |d| at as many samples behind the other turns.
Where the drive moves the stage far within the window, a rough fit errs by a part of that motion:
|d| must exceed a tenth of it as well. [Hampel 1974]

Every play forgets its initial state once the drive's range has reached twice its threshold. Until
then the output depends on a past that was not recorded. An admissible initial memory explains most
of it; a transient from before the record (a step just before, a controller that was switched on)
does not, and would corrupt the weights.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece
from piezoid.identification.hysteresis.search import Fitted, continued
from piezoid.numerics.arrays import Array, Samples
from piezoid.operators.play import forgetting_sample
from piezoid.records.reversals import noise_of, reversals_of

FACTOR = 8.0  # robust standard deviations: one of 1e15 normal residuals
WIDTH = 9  # samples of the median, of which four may be wrong
AROUND = 10  # samples on either side that show ringing
RINGING = 0.7  # of these
STEEP = 0.8  # of its distance from the median: less is a corner
SOLE = 0.9  # of a pair's, for a corner is three quarters
BEFORE, BEHIND = 2, 8  # samples about a turn in which a law bends as a rough fit does not
TURNS = 3  # number of reversals that show the usual deviation
MOTION = 0.1  # of the motion in the window: allowed error of a rough fit
PASSES = 3  # one of two neighbouring outliers may hide the other
MAX_SHARE = 0.1  # of a piece: more are no outliers
TRANSIENT = 3.0  # rms of a beginning over that of the rows behind it


def without_outliers(fitted: Fitted) -> tuple[tuple[Piece, ...], tuple[str, ...]]:
    """Exclude single outliers from the pieces of a fit, with a remark for each piece."""
    pieces, remarks = [], []
    for index, piece in enumerate(fitted.task.pieces):
        error = continued(fitted, index, piece) - piece.response
        outliers = outlying(error, piece.drive, piece.response)
        outliers = outliers[(outliers >= piece.first) & (outliers < piece.last)]
        missing = np.union1d(piece.lost, outliers)
        count = len(missing) - len(piece.lost)
        if len(outliers):
            sample = np.arange(len(piece.response))
            measured = np.setdiff1d(sample, missing)
            response = np.interp(sample, measured, piece.response[measured])
            piece = replace(piece, response=response, lost=missing.astype(np.intp))
        if count:
            remarks.append(
                f"{piece.name}: {count} single readings ({100 * count / piece.rows:.2g} %) that "
                "stand far out of their neighbours and of the fit were left out."
            )
        pieces.append(piece)
    return tuple(pieces), tuple(remarks)


def without_transients(fitted: Fitted) -> tuple[tuple[Piece, ...], tuple[str, ...]]:
    """Return the pieces without beginnings that no admissible memory explains, and remarks.

    A beginning ends where the drive has made every play forget its past. It is left out where
    its rms residual is ``TRANSIENT`` times that of the later rows.
    """
    pieces, remarks, thresholds = [], [], fitted.operator.threshold
    for index, piece in enumerate(fitted.task.pieces):
        rows = int(forgetting_sample(piece.fitted_drive, thresholds).max(initial=0))
        if rows >= 2 and piece.rows - rows >= max(MINIMUM_SAMPLES, piece.rows // 3):
            error = continued(fitted, index, piece) - piece.response
            error[piece.lost] = 0.0
            error = error[piece.first : piece.last]
            early, later = (float(np.sqrt(np.mean(e**2))) for e in (error[:rows], error[rows:]))
            misfit = early / max(later, 1e-300)
            if misfit > TRANSIENT:
                remarks.append(
                    f"{piece.name}: the first {rows} samples were left out; no initial memory "
                    f"explains them ({misfit:.1f} times the later error)."
                )
                piece = replace(piece, first=piece.first + rows)
        pieces.append(piece)
    return tuple(pieces), tuple(remarks)


def outlying(error: Array, drive: Array, response: Array) -> Samples:
    """Return the samples at which a residual is an outlier among its neighbours, increasing.

    error, drive, response  (samples,)  any unit; response and error in the same unit
    """
    turns = np.array([0, *reversals_of(drive, noise_of(drive))])
    lag = np.full(len(drive), BEHIND + 1)  # samples behind a turn; BEHIND + 1 behind none
    if len(turns) > TURNS:
        for behind in (*range(-BEFORE, 0), *range(BEHIND, -1, -1)):
            sample = turns + behind
            lag[sample[(sample >= 0) & (sample < len(drive))]] = behind
    # The motion expected from the drive within the window of every sample.
    levels = (0.002, 0.998)
    gain = np.ptp(np.quantile(response, levels)) / max(np.ptp(np.quantile(drive, levels)), 1e-300)
    motion = gain * (maximum_filter1d(drive, WIDTH) - minimum_filter1d(drive, WIDTH))
    inliers = np.arange(len(error))
    for _ in range(PASSES):
        if len(inliers) <= 4 * WIDTH:
            break
        outliers = _outliers(error[inliers], lag[inliers], motion[inliers])
        if not len(outliers):
            break
        inliers = np.delete(inliers, outliers)
    return np.setdiff1d(np.arange(len(error)), inliers)


def _outliers(error: Array, lag: Samples, motion: Array) -> Samples:
    padded = np.pad(error, WIDTH // 2, mode="reflect", reflect_type="odd")
    windows = np.lib.stride_tricks.sliding_window_view(padded, WIDTH)
    distance = np.abs(error - np.median(windows, axis=1))
    scale = 1.4826 * float(np.median(distance))
    candidates = np.flatnonzero(distance > np.maximum(FACTOR * scale, MOTION * motion))
    if scale == 0.0 or len(candidates) > MAX_SHARE * len(error):
        return np.zeros(0, dtype=np.intp)
    around = [distance[max(k - AROUND, 0) : k + AROUND + 1] for k in candidates.tolist()]
    local = np.array([np.quantile(values, RINGING) for values in around])
    usual = np.zeros(len(distance))  # as many samples behind a turn
    for behind in range(-BEFORE, BEHIND + 1):
        rows = lag == behind
        if np.count_nonzero(rows) > TURNS:
            usual[rows] = np.quantile(distance[rows], RINGING)
    limit = FACTOR * np.maximum(local, usual[candidates])
    candidates = candidates[distance[candidates] > limit]
    return np.asarray(candidates[_steepness(error, candidates) > STEEP * distance[candidates]])


def _steepness(error: Array, sample: Samples) -> Array:
    """Return the distance of samples, single or in pairs, from their neighbours.

    At a corner of the residual, at the start of a branch that the fit does not follow, a sample
    differs from its two neighbours by half as much as from the median of nine, or by three
    quarters of that from the next but one.
    """
    padded = np.pad(error, 2, mode="edge")
    at, steps = sample + 2, []
    single = np.abs(padded[at] - 0.5 * (padded[at - 1] + padded[at + 1]))
    for side in (-1, 1):
        level = 0.5 * (padded[at - side] + padded[at + 2 * side])
        pair = padded[at] - level, padded[at + side] - level
        smaller = np.minimum(np.abs(pair[0]), np.abs(pair[1]))
        steps.append(np.where(pair[0] * pair[1] > 0.0, smaller, 0.0) * SOLE)
    return np.asarray(np.max([single, *steps], axis=0))
