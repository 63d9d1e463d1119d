"""Operators with a limit: a largest speed, and barriers climbed by thermal activation."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous


def slewed(signal: Array, step: float) -> Array:
    """Return a signal that goes at most a step from sample to sample.

        z[k] = z[k-1] + clamp(u[k] - z[k-1], -step, step),   z[0] = u[0]

    signal    (samples,)
    step      scalar, > 0, in the signal's unit
    returned  (samples,)
    """
    given = contiguous(signal)
    found = np.empty_like(given)
    KERNELS.pk_slew(len(given), address(given), step, address(found))
    return found


def activated(irreversible: Array, time_s: float, sampling_rate_Hz: float, strain: float) -> Array:
    """Return an irreversible response that climbs its barriers by thermal activation.

        dx/dt = (s / tau) sinh((h - x) / s),   exact for steps of h    [Eyring 1936]

    h    irreversible  (samples,)  any unit; what would be reached without haste
    tau  time_s        scalar      s, time constant of small lags
    s    strain        scalar      unit of h; lags beyond it grow with the logarithm of the speed
    """
    given = contiguous(irreversible)
    found = np.empty_like(given)
    step = float(np.exp(-1.0 / (time_s * sampling_rate_Hz)))
    KERNELS.pk_activated(len(given), address(given), step, 2.0 * strain, address(found))
    return found
