"""Slew limit and thermally activated motion."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous


def slewed(signal: Array, step: float) -> Array:
    """Limit the change of a signal between samples.

        z[k] = z[k-1] + clamp(u[k] - z[k-1], -step, step),   z[0] = u[0]

    signal    (samples,)
    step      scalar, > 0, in the signal's unit
    returned  (samples,)
    """
    source = contiguous(signal)
    output = np.empty_like(source)
    KERNELS.pk_slew(len(source), address(source), step, address(output))
    return output


def activated(irreversible: Array, time_s: float, sampling_rate_Hz: float, strain: float) -> Array:
    """Return a rate-dependent irreversible response: barriers crossed by thermal activation.

        dx/dt = (s / tau) sinh((h - x) / s),   exact for steps of h    [Eyring 1936]

    h    irreversible  (samples,)  any unit; the quasi-static response
    tau  time_s        scalar      s, time constant of small lags
    s    strain        scalar      unit of h; lags beyond it grow with the logarithm of the speed
    """
    source = contiguous(irreversible)
    output = np.empty_like(source)
    step = float(np.exp(-1.0 / (time_s * sampling_rate_Hz)))
    KERNELS.pk_activated(len(source), address(source), step, 2.0 * strain, address(output))
    return output
