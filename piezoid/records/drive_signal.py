"""Shape of a drive: turning points, isolated steps, whether it is constant or has a response."""

from math import sqrt

import numpy as np

from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.robust import white_noise_rms

NOISE_BAND = 6.0  # standard deviations; the reading of a constant drive stays within it
MAX_SHARE = 0.2  # of the drive's range; without this limit a white drive would count as noise


def noise_of(drive: Array) -> float:
    """Return the largest excursion of a drive that the noise of its reading explains."""
    return min(NOISE_BAND * white_noise_rms(drive), MAX_SHARE * float(np.ptp(drive)))


def reversals_of(voltage_V: Array, noise_V: float) -> tuple[int, ...]:
    """Find the turning points of a drive, ignoring excursions of at most ``noise_V``.

    A turning point is confirmed once the drive has moved away from it by more than ``noise_V``,
    so converter steps and read-back noise do not count as reversals.

    voltage_V  (samples,)  V
    noise_V    scalar      V, >= 0
    returned   indices, increasing, without the first and the last sample
    """
    turns: list[int] = []
    high = low = 0
    direction = 0
    values_V = voltage_V.tolist()
    for k, value in enumerate(values_V):
        if value > values_V[high]:
            high = k
        if value < values_V[low]:
            low = k
        if direction >= 0 and values_V[high] - value > noise_V:
            if direction > 0 or high > 0:
                turns.append(high)
            direction, low, high = -1, k, k
        elif direction <= 0 and value - values_V[low] > noise_V:
            if direction < 0 or low > 0:
                turns.append(low)
            direction, low, high = 1, k, k
    return tuple(turns)


MIN_STEP = 0.03  # half ranges in one sample
ISOLATION = 4.0  # step over its neighbours


def isolated_steps(level: Array) -> Samples:
    """Return the samples before isolated steps of a drive, in order.

    A step is isolated if it exceeds ``ISOLATION`` times the steps three samples before and after.

    level  (samples,)  drive, scaled to -1 .. 1
    """
    step = np.abs(np.diff(level))
    padded = np.pad(step, 3)
    neighbour = np.maximum(padded[:-6], padded[6:])
    return np.flatnonzero((step > MIN_STEP) & (step > ISOLATION * neighbour))


NOISE_RANGE = 10.0  # standard deviations: a range that Gaussian noise does not reach
# A white drive has the differences of noise, but the sensor follows it. Behind a lag of ten
# samples the largest correlation is 0.3; one in a million pairs of independent signals exceeds
# five standard errors.
MIN_CORRELATION, STANDARD_ERRORS = 0.3, 5.0
# Sum of squared correlations: 0.3 to 0.04 for white drives into modes of Q 0.5 to 40, 0.1 to 5 for
# wideband recordings of other simulators, 0.001 for sensors held by servos with a gain of 0.02 to
# 0.6 per sample. A white drive without lag gives 1 at lag 0. The steps of such a servo's drive
# have a correlation of -0.33 or more.
MIN_SPREAD, MIN_AT_ONCE, MAX_WHITE = 0.03, 0.3, -0.4
LAGS = 64  # samples: largest delay of the response


def is_at_rest(drive: Array, response: Array) -> bool:
    """Return whether a drive is constant within the noise of its reading.

    response  displacement of the axis, which follows a drive that is noise on purpose
    """
    if not np.ptp(drive) > 0.0:
        return True
    if np.ptp(drive) > NOISE_RANGE * white_noise_rms(drive):
        return False
    return not has_response(drive, response)


def has_response(drive: Array, response: Array) -> bool:
    """Return whether a response follows the steps of a drive to any extent.

    The correlation is larger behind the steps than before them, or larger than that of hum.
    """
    spread, forward, count = _correlations(drive, response)
    error = sqrt(8.0 * LAGS) / count  # twice that of white signals: neighbours share a sample
    largest = float(np.abs(forward).max())
    return spread > STANDARD_ERRORS * error or largest > max(
        MIN_CORRELATION, STANDARD_ERRORS / sqrt(count)
    )


def is_mostly_driven(drive: Array, response: Array) -> bool:
    """Return whether the steps of a response are mostly caused by those of a drive.

    Under feedback the drive contains the noise of the sensor, and the stage follows one sample
    later: r(1) = -r(0), and the product is subtracted. The steps of a white drive, with a
    correlation of -1/2, give the same without feedback; nothing is subtracted for them.
    """
    spread, forward, count = _correlations(drive, response)
    steps = np.diff(drive)
    is_white = float(steps[1:] @ steps[:-1]) < MAX_WHITE * float(steps @ steps)
    returned = 0.0 if is_white else max(0.0, -float(forward[0] * forward[1]))
    threshold = max(MIN_SPREAD, STANDARD_ERRORS * sqrt(8.0 * LAGS) / count)
    return spread - returned > threshold or float(forward[0]) ** 2 - returned > MIN_AT_ONCE


def _correlations(drive: Array, response: Array) -> tuple[float, Array, int]:
    """Return the excess of squared correlations behind the steps, r(0) ... r(LAGS), and the count.

    A mode spreads the response over many lags. The excess is

        sum of r(l)^2 - sum of r(-l)^2,   l = 1 ... LAGS

    where the second sum is a placebo: common hum correlates in both directions.
    """
    steps, answer = np.diff(drive), np.diff(response)
    size = sqrt(float(steps @ steps) * float(answer @ answer))
    count = max(len(steps), 1)
    if size == 0.0 or count <= LAGS:
        return 0.0, np.zeros(LAGS + 1), count
    forward = np.array([steps[: count - lag] @ answer[lag:] for lag in range(LAGS + 1)]) / size
    backward = np.array([answer[: count - lag] @ steps[lag:] for lag in range(1, LAGS + 1)]) / size
    return float(forward[1:] @ forward[1:] - backward @ backward), forward, count
