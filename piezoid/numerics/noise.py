"""Rms of the noise of a smooth signal, from its differences."""

import numpy as np

from piezoid.numerics.arrays import Array

_THIRD = float(np.sqrt(20.0))  # third differences of white noise of rms 1
_MEDIAN = 0.6744897501960817  # median of |x| for a standard normal x


def white_noise_rms(signal: Array, spacing: int = 1) -> float:
    """Return the rms of the white part of a slowly varying signal's noise.

    Third differences remove smooth motion; the median of their magnitude is robust to jumps and to
    the few samples at reversals.

    signal   (samples,)  any unit; differences with NaN are omitted; the result is 0 for fewer than
             ``8 * spacing`` samples
    spacing  number of samples between the values of a difference
    """
    if len(signal) < 8 * spacing:
        return 0.0
    third = signal
    for _ in range(3):
        third = third[spacing:] - third[:-spacing]
    finite = third[~np.isnan(third)]
    return float(np.median(np.abs(finite))) / (_MEDIAN * _THIRD) if len(finite) else 0.0
