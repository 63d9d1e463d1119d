"""Rows excluded from a fit: single outliers, and initial transients that no memory explains.

    d[k] = e[k] - median(e[k-4..k+4]),   outlier if |d| > 8 max(s, local), s = 1.4826 median |d|

The residual e of a rough fit is smooth compared with a single wrong reading, also where the
response itself is steep. Large |d| at many neighbours is ringing: ``local`` is the 70 % quantile
of |d| around the sample. A rough fit repeats its error behind every reversal of the drive: there
``local`` is at least that quantile of |d| the same number of samples behind the other reversals. A
rough fit also errs by a share of the motion within the window: |d| must exceed a tenth of that
motion as well. [Hampel 1974]

Every play forgets its initial state once the drive's range has reached twice its threshold. Until
then the output depends on a past that was not recorded. An admissible initial memory explains most
of it; a transient from before the record (a step just before, a controller that was switched on)
does not fit any memory and would corrupt the weights.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from piezoid.identification.hysteresis.gauss_newton import HysteresisFit
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece
from piezoid.numerics.arrays import Array, Samples
from piezoid.operators.play import forgetting_sample
from piezoid.records.drive_signal import noise_of, reversals_of

FACTOR = 8.0  # robust standard deviations: one of 1e15 normal residuals
WIDTH = 9  # samples of the median, of which four may be wrong
AROUND = 10  # samples on either side that show ringing
RINGING_QUANTILE = 0.7  # of |d| among these samples
STEEP = 0.8  # distance from the neighbours over that from the median: less is a corner
PAIR_SHARE = 0.9  # of a pair's distance that counts: at a corner it is three quarters
BEFORE, BEHIND = 2, 8  # samples about a reversal in which a rough fit repeats its error
MIN_REVERSALS = 3  # reversals that show the repeated error
MOTION = 0.1  # of the motion in the window: allowed error of a rough fit
PASSES = 3  # an outlier may hide its neighbour from the first pass
MAX_SHARE = 0.1  # of a piece: a larger share of rows is no set of outliers
TRANSIENT = 3.0  # rms of the first rows over that of the later rows


def without_outliers(fit: HysteresisFit) -> tuple[tuple[Piece, ...], tuple[str, ...]]:
    """Return the pieces of a fit without single outliers, and a remark for each changed piece."""
    pieces, remarks = [], []
    for index, piece in enumerate(fit.task.pieces):
        error = fit.simulate(index, piece) - piece.response
        outliers = outlying_samples(error, piece.drive, piece.response)
        outliers = outliers[(outliers >= piece.first) & (outliers < piece.last)]
        invalid = np.union1d(piece.invalid, outliers)
        count = len(invalid) - len(piece.invalid)
        if len(outliers):
            sample = np.arange(len(piece.response))
            measured = np.setdiff1d(sample, invalid)
            response = np.interp(sample, measured, piece.response[measured])
            piece = replace(piece, response=response, invalid=invalid.astype(np.intp))
        if count:
            remarks.append(
                f"{piece.name}: single readings were excluded ({count}, "
                f"{100 * count / piece.rows:.2g} %): they deviate far from their neighbours and "
                "from the fit."
            )
        pieces.append(piece)
    return tuple(pieces), tuple(remarks)


def without_transients(fit: HysteresisFit) -> tuple[Piece, ...]:
    """Return the pieces without transients that no admissible memory explains.

    The first rows end where every play has forgotten its initial state. They are excluded if their
    rms residual exceeds ``TRANSIENT`` times that of the later rows.
    """
    pieces, thresholds = [], fit.operator.threshold
    for index, piece in enumerate(fit.task.pieces):
        rows = int(forgetting_sample(piece.fitted_drive, thresholds).max(initial=0))
        if rows >= 2 and piece.rows - rows >= max(MINIMUM_SAMPLES, piece.rows // 3):
            error = fit.simulate(index, piece) - piece.response
            error[piece.invalid] = 0.0
            error = error[piece.first : piece.last]
            early, later = (float(np.sqrt(np.mean(e**2))) for e in (error[:rows], error[rows:]))
            if early > TRANSIENT * later:
                piece = replace(piece, first=piece.first + rows)
        pieces.append(piece)
    return tuple(pieces)


def outlying_samples(error: Array, drive: Array, response: Array) -> Samples:
    """Return the samples, increasing, at which a residual is an outlier among its neighbours.

    error, drive, response  (samples,)  any unit; response and error in the same unit
    """
    reversals = np.array([0, *reversals_of(drive, noise_of(drive))])
    lag = np.full(len(drive), BEHIND + 1)  # samples behind a reversal; BEHIND + 1: far behind
    if len(reversals) > MIN_REVERSALS:
        for behind in (*range(-BEFORE, 0), *range(BEHIND, -1, -1)):
            sample = reversals + behind
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
    """Return one pass of outliers: far from the median and, unlike corners, from neighbours.

    At a corner of the residual (the start of a branch that the fit does not follow), the distance
    of a sample from its neighbours is half of that from the median of nine samples; of a pair up
    to three quarters of it.
    """
    padded = np.pad(error, WIDTH // 2, mode="reflect", reflect_type="odd")
    windows = np.lib.stride_tricks.sliding_window_view(padded, WIDTH)
    distance = np.abs(error - np.median(windows, axis=1))
    scale = 1.4826 * float(np.median(distance))
    candidates = np.flatnonzero(distance > np.maximum(FACTOR * scale, MOTION * motion))
    if scale == 0.0 or len(candidates) > MAX_SHARE * len(error):
        return np.zeros(0, dtype=np.intp)
    around = [distance[max(k - AROUND, 0) : k + AROUND + 1] for k in candidates.tolist()]
    local = np.array([np.quantile(values, RINGING_QUANTILE) for values in around])
    repeated = np.zeros(len(distance))  # at the same number of samples behind other reversals
    for behind in range(-BEFORE, BEHIND + 1):
        rows = lag == behind
        if np.count_nonzero(rows) > MIN_REVERSALS:
            repeated[rows] = np.quantile(distance[rows], RINGING_QUANTILE)
    limit = FACTOR * np.maximum(local, repeated[candidates])
    candidates = candidates[distance[candidates] > limit]
    # Distance of the candidates, single or in pairs, from their neighbours.
    padded = np.pad(error, 2, mode="edge")
    k = candidates + 2
    steepness = np.abs(padded[k] - 0.5 * (padded[k - 1] + padded[k + 1]))
    for side in (-1, 1):
        level = 0.5 * (padded[k - side] + padded[k + 2 * side])
        pair = padded[k] - level, padded[k + side] - level
        smaller = np.minimum(np.abs(pair[0]), np.abs(pair[1]))
        of_pair = np.where(pair[0] * pair[1] > 0.0, smaller, 0.0) * PAIR_SHARE
        steepness = np.maximum(steepness, of_pair)
    return np.asarray(candidates[steepness > STEEP * distance[candidates]])
