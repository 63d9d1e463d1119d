"""Sensor noise: from repeated periods if there are any, else from the residual.

    s = rms(y[k + P] - y[k]) / sqrt 2,      for a drive that repeats after P samples
    s = min(rms(y), rms(y - model)),        for any other drive

``rms`` is that of third differences, which suppress smooth motion. A coarse, jumping or random
drive moves the stage from sample to sample, and third differences of that motion look like noise.
They cancel between two equal periods, and the residual contains little of them. A coarse converter
errs by its step over sqrt 12 in any case.

Noise is not white: the pole of a sensor correlates neighbouring samples, and part of the noise is
1/f. Differences of neighbouring samples contain neither, so the spacing of the differences is
doubled as long as their rms grows like noise. One octave of 1/f noise with 40 % of the variance
adds 1 % to the rms; a motion multiplies it by eight.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece
from piezoid.numerics.arrays import Array
from piezoid.numerics.repetition import TOLERANCE, find_repetition
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.sample_statistics import step_size

MIN_REPEATED = 0.9  # of the samples
MAX_GROWTH = 1.1  # from one spacing to its double: between 1.01 of 1/f noise and 8 of a motion
SAMPLES_PER_SPACING = 64  # with fewer the median itself is noisy
POLE_OCTAVES = 2  # of spacing, within which the correlation due to a sensor's pole vanishes
MOTION = 2.0  # noise of the readings over that of the residual: with more, they are mostly motion
DIGITS = 9  # of half the stroke: makes the step independent of rounding


def sensor_noise(piece: Piece, residual: Array) -> tuple[float, bool]:
    """Return the rms noise of the readings of a piece, scaled units, and whether it is a bound.

    residual  (samples,)  model minus measurement

    The noise is an upper bound if a drive that never repeats moves the stage from sample to
    sample: differences of the readings are then motion, and those of the residual contain errors
    of the model.
    """
    drive, response = piece.fitted_drive, piece.fitted_response
    residual = residual[piece.first : piece.last]
    step = step_size(np.round(response, DIGITS))
    is_invalid = np.isin(np.arange(piece.first, piece.last), piece.invalid)
    valid = np.where(is_invalid, np.nan, response)
    repetition = find_repetition(drive) if np.ptp(drive) > 0.0 else None
    period = None if repetition is None else repetition.period_samples
    if period is None:
        for periods in (2, 3):  # too few for find_repetition, if the record ends with a period
            length = len(drive) // periods
            repeats = np.abs(drive[length:] - drive[:-length]) <= TOLERANCE * np.ptp(drive)
            if length >= MINIMUM_SAMPLES and repeats.mean() > MIN_REPEATED:
                period = length
                break
    if period is not None:
        change = valid[period:] - valid[:-period]
        change = change[np.abs(drive[period:] - drive[:-period]) <= TOLERANCE * np.ptp(drive)]
        noise, is_bound = noise_rms((change,)) / sqrt(2.0), False
    else:
        noise = noise_rms((valid, np.where(is_invalid, np.nan, residual)))
        is_bound = white_noise_rms(response) > MOTION * white_noise_rms(residual)
    return max(noise, step / sqrt(12.0)), is_bound


def noise_rms(signals: Sequence[Array]) -> float:
    """Return the rms noise common to all signals, up to the spacing at which motion dominates.

    signals  each (samples,): the same reading, minus different estimates of its motion
    """
    octaves = max(1, (len(signals[0]) // SAMPLES_PER_SPACING).bit_length())
    levels = np.array(
        [min(white_noise_rms(y, spacing=2**octave) for y in signals) for octave in range(octaves)]
    )
    if not levels.all():  # the reading is constant within a step of its converter
        return float(levels[0])
    growth = levels[1:] / levels[:-1]
    octave = 0
    while octave < len(growth):
        # Noise behind a pole grows at most like a random walk, and ever more slowly.
        pair = growth[octave : octave + 2]
        slows = octave < POLE_OCTAVES and len(pair) == 2 and bool(pair[1] < pair[0] < sqrt(2.0))
        if growth[octave] > MAX_GROWTH and not slows:
            break
        octave += 1
    return float(levels[: octave + 1].max())
