"""Find the turning points of a drive: the ends of its monotone branches."""

import numpy as np

from piezoid.numerics.arrays import Array
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
    for k, value in enumerate(voltage_V.tolist()):
        if value > voltage_V[high]:
            high = k
        if value < voltage_V[low]:
            low = k
        if direction >= 0 and voltage_V[high] - value > noise_V:
            if direction > 0 or high > 0:
                turns.append(high)
            direction, low, high = -1, k, k
        elif direction <= 0 and value - voltage_V[low] > noise_V:
            if direction < 0 or low > 0:
                turns.append(low)
            direction, low, high = 1, k, k
    return tuple(turns)
