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
    """Tell whether a response follows the steps of a drive within some samples.

    A mode spreads what follows over many lags. The squares of all of them are summed,

        sum of r(l)^2, l = 1 ... LAGS,   less the same of r(-l)

    whose second half is the placebo: hum that both channels read correlates either way.
    """
    steps, answers = np.diff(drive), np.diff(response)
    size = sqrt(float(steps @ steps) * float(answers @ answers))
    if size == 0.0 or len(steps) <= LAGS:
        return False
    count = len(steps)
    after = np.array([steps[: count - lag] @ answers[lag:] for lag in range(LAGS + 1)]) / size
    before = np.array([answers[: count - lag] @ steps[lag:] for lag in range(1, LAGS + 1)]) / size
    error = sqrt(8.0 * LAGS) / count  # neighbours share a sample: twice that of white signals
    spread = float(after[1:] @ after[1:] - before @ before)
    return spread > ERRORS * error or float(np.abs(after).max()) > max(
        FOLLOWS, ERRORS / sqrt(count)
    )
