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
# Of outsiders' wideband recordings and white drives into a mode the sum of squares less r(0)^2 is
# 0.1 to 5, of two sensors that a servo holds below 0.001. Hum in both makes r(0)^2 up to 0.1.
ANSWERS, AT_ONCE = 0.03, 0.5
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

    Under feedback the noise of the sensor goes into the drive at once, and comes back with the
    other sign: r(1) = - r(0), which is taken off.
    """
    spread, after, count = _after(drive, response)
    at_once = float(after[0]) ** 2
    return at_once > AT_ONCE or spread - at_once > max(ANSWERS, ERRORS * sqrt(8.0 * LAGS) / count)


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
