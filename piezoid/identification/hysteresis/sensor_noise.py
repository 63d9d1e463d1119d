"""Sensor noise: from repeated periods if there are any, else from the residual.

    s = rms(y[k + P] - y[k]) / sqrt 2,      a drive that repeats itself after P samples
    s = min(rms(y), rms(y - model)),        any other

``rms`` takes third differences, which a smooth motion leaves none of. A drive that is coarse,
jumps or is drawn at random moves the stage from sample to sample, and its own third differences
would pass for noise: they cancel between two equal periods, and from the residual most of them are
gone. A coarse converter errs by its step over sqrt 12 whatever the differences say.

Noise is not white: a sensor's pole makes neighbours alike, and part of it is 1/f. Differences of
neighbours see neither, so they are taken ever further apart, for as long as they grow as noise
does. One octave of 1/f noise that is 40 % of the variance adds 1 % to the rms; a motion doubles
it three times over.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.numerics.repetition import TOLERANCE, find_repetition
from piezoid.records.sample_statistics import step_size

MOST = 0.9  # of the samples that must repeat
GROWTH = 1.1  # from one spacing to its double: between 1.01 of 1/f noise and 8 of a motion
FEWEST = 64  # samples for each sample of spacing, or the median is itself noise
POLE = 2  # octaves in which a sensor's pole may let go of its neighbours
MOTION = 2.0  # times the noise of the residual: more is mostly motion
DIGITS = 9  # of half the stroke: a step is the same however it was rounded


def sensor_noise(piece: Piece, residual: Array) -> float:
    """Return the rms of the noise of a piece's readings, scaled units.

    residual  (samples,)  model minus measurement
    """
    drive, response = piece.fitted_drive, piece.fitted_response
    step = step_size(np.round(response, DIGITS))
    is_lost = np.isin(np.arange(piece.first, piece.last), piece.lost)
    response = np.where(is_lost, np.nan, response)
    later = _one_period_later(drive)
    if later is not None:
        between = response[later:] - response[:-later]
        between = between[np.abs(drive[later:] - drive[:-later]) <= TOLERANCE * np.ptp(drive)]
        noise = noise_rms((between,)) / sqrt(2.0)
    else:
        noise = noise_rms(
            (response, np.where(is_lost, np.nan, residual[piece.first : piece.last]))
        )
    return max(noise, step / sqrt(12.0))


def noise_is_most(piece: Piece, residual: Array) -> bool:
    """Tell whether noise is not told from what a model leaves: the readings alone do not show it.

    Where a drive that never repeats moves the stage from sample to sample, the readings' own
    differences are motion, and those of the residual are whatever the model got wrong as well.
    """
    if _one_period_later(piece.fitted_drive) is not None:
        return False
    residual_noise = white_noise_rms(residual[piece.first : piece.last])
    return white_noise_rms(piece.fitted_response) > MOTION * residual_noise


def noise_rms(signals: Sequence[Array]) -> float:
    """Return the rms of noise that all signals hold, up to the spacing at which motion shows.

    signals  each (samples,): one reading with different parts of its motion taken off
    """
    octaves = max(1, (len(signals[0]) // FEWEST).bit_length())
    levels = np.array(
        [min(white_noise_rms(y, spacing=2**octave) for y in signals) for octave in range(octaves)]
    )
    if not levels.all():  # a converter so coarse that it stands: its step is the noise
        return float(levels[0])
    growth = levels[1:] / levels[:-1]
    octave = 0
    while octave < len(growth):
        # The growth of a pole is never above that of a random walk, and ever slower.
        pair = growth[octave : octave + 2]
        slows = octave < POLE and len(pair) == 2 and bool(pair[1] < pair[0] < sqrt(2.0))
        if growth[octave] > GROWTH and not slows:
            break
        octave += 1
    return float(levels[: octave + 1].max())


def _one_period_later(drive: Array) -> int | None:
    """Return the period of a drive in samples, seen at least twice, or None."""
    repetition = find_repetition(drive) if np.ptp(drive) > 0.0 else None
    if repetition is not None:
        return repetition.period_samples
    for parts in (2, 3):  # too few to be found, but the record may be cut at them
        later = len(drive) // parts
        repeats = np.abs(drive[later:] - drive[:-later]) <= TOLERANCE * np.ptp(drive)
        if later >= MINIMUM_SAMPLES and repeats.mean() > MOST:
            return later
    return None
