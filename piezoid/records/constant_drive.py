"""Whether a stage's drive rests: dead, or no more than the noise of its own reading."""

from math import sqrt

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.recording import Recording

NOISE = 10.0  # times its rms: a range that normal noise does not reach in any recording
# Of a drive drawn anew at every sample the differences look like noise as well; there the sensor
# follows it. Behind a lag of ten samples the largest correlation is 0.3, and of two independent
# signals one in a million goes beyond five standard errors.
FOLLOWS, ERRORS = 0.3, 5.0
# White drives into modes of Q 0.5 to 40 leave 0.3 to 0.04, outsiders' wideband recordings 0.1 to
# 5, sensors that servos of a gain of 0.02 to 0.6 a sample hold 0.001; a white drive that is
# followed at once 1. The steps of such a servo's drive correlate by - 0.33 at least.
ANSWERS, AT_ONCE, WHITE = 0.03, 0.3, -0.4
LAGS = 64  # samples by which a stage may follow


def is_at_rest(recording: Recording, axis: str) -> bool:
    """Tell whether the drive of an axis does nothing but read its own noise."""
    voltage_V = recording.voltage_V(axis)
    if not np.ptp(voltage_V) > 0.0:
        return True
    if np.ptp(voltage_V) > NOISE * white_noise_rms(voltage_V):
        return False
    return not follows(voltage_V, recording.displacement_m(axis))


def follows(drive: Array, response: Array) -> bool:
    """Tell whether a response follows the steps of a drive within some samples, however little.

    Either more after it than before it, or so much that hum in both channels could not.
    """
    spread, after, count = _after(drive, response)
    error = sqrt(8.0 * LAGS) / count  # neighbours share a sample: twice that of white signals
    largest = float(np.abs(after).max())
    return spread > ERRORS * error or largest > max(FOLLOWS, ERRORS / sqrt(count))


def answers(drive: Array, response: Array) -> bool:
    """Tell whether the steps of a response are, for a good part, the answer to those of a drive.

    Under feedback the drive takes up what the sensor reads, and the stage follows a sample later:
    r(1) = - r(0), whose product is taken off. Of a drive drawn anew at every sample, whose own
    steps correlate by - 1/2, the answer looks like that, and no servo's drive is.
    """
    spread, after, count = _after(drive, response)
    steps = np.diff(drive)
    is_white = float(steps[1:] @ steps[:-1]) < WHITE * float(steps @ steps)
    returned = 0.0 if is_white else max(0.0, -float(after[0] * after[1]))
    least = max(ANSWERS, ERRORS * sqrt(8.0 * LAGS) / count)
    return spread - returned > least or float(after[0]) ** 2 - returned > AT_ONCE


def _after(drive: Array, response: Array) -> tuple[float, Array, int]:
    """Return the sum of squares after less before, r(0) ... r(LAGS), and the number of steps.

    A mode spreads what follows over many lags. The squares of all of them are summed,

        sum of r(l)^2, l = 1 ... LAGS,   less the same of r(-l)

    whose second half is the placebo: hum that both channels read correlates either way.
    """
    steps, answer = np.diff(drive), np.diff(response)
    size = sqrt(float(steps @ steps) * float(answer @ answer))
    count = max(len(steps), 1)
    if size == 0.0 or count <= LAGS:
        return 0.0, np.zeros(LAGS + 1), count
    after = np.array([steps[: count - lag] @ answer[lag:] for lag in range(LAGS + 1)]) / size
    before = np.array([answer[: count - lag] @ steps[lag:] for lag in range(1, LAGS + 1)]) / size
    return float(after[1:] @ after[1:] - before @ before), after, count
