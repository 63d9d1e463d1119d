"""The white noise of the sensor: of repeated periods where there are any, else of what is left.

    s = rms_white(y[k + P] - y[k]) / sqrt 2,            a drive that repeats itself after P samples
    s = min(rms_white(y), rms_white(y - model)),        any other

``rms_white`` takes third differences, which a smooth motion leaves none of. A drive that is
coarse, jumps or is drawn at random moves the stage from sample to sample, and its own third
differences would pass for noise: they cancel between two equal periods, and from the residual most
of them are gone. A coarse converter errs by its step over sqrt 12 whatever the differences say.
"""

from math import sqrt

import numpy as np

from piezoid.identification.dynamics.repetition import SAME, find_repetition
from piezoid.identification.hysteresis.pieces import MINIMUM_SAMPLES, Piece
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.faults import step_size

MOST = 0.9  # of the samples that must repeat
DIGITS = 9  # of half the stroke: a step is the same however it was rounded


def sensor_noise(piece: Piece, residual: Array) -> float:
    """Return the rms of the white noise of a piece's readings, scaled units.

    residual  (samples,)  model minus measurement
    """
    rows = slice(piece.first, piece.last)
    drive, response = piece.drive[rows], piece.response[rows]
    step = step_size(np.round(response, DIGITS))
    later = _one_period_later(drive)
    if later is not None:
        between = response[later:] - response[:-later]
        between = between[np.abs(drive[later:] - drive[:-later]) <= SAME * np.ptp(drive)]
        found = white_noise_rms(between) / sqrt(2.0)
    else:
        found = min(white_noise_rms(response), white_noise_rms(residual[rows]))
    return max(found, step / sqrt(12.0))


def _one_period_later(drive: Array) -> int | None:
    """Return after how many samples a drive repeats itself, two periods being enough, or None."""
    found = find_repetition(drive) if np.ptp(drive) > 0.0 else None
    if found is not None:
        return found.period_samples
    for parts in (2, 3):  # too few to be found, but the record may be cut at them
        later = len(drive) // parts
        same = np.abs(drive[later:] - drive[:-later]) <= SAME * np.ptp(drive)
        if later >= MINIMUM_SAMPLES and same.mean() > MOST:
            return later
    return None
