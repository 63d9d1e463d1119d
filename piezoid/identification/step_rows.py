"""Rows behind isolated steps of the drive, whose instants within a sample are unknown."""

from collections.abc import Sequence
from math import ceil, pi

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.numerics.arrays import Array, Samples

JUMP = 0.03  # half ranges in one sample, four times the neighbouring steps: an isolated step
RESOLVED = 0.1  # of the sampling rate: the instant of a step turns the ringing by 36 degrees
DECAYS = 8.0  # time constants of the ringing: 3e-4 of it are left


def rows_after_steps(
    level: Array, rate_Hz: float, extensions: Sequence[Extension] = (), *, least: int = 0
) -> Samples:
    """Return the rows that depend on the instant of an isolated step within its sample.

        n = max(least, 8 Q rate / (pi f))    rows, for a mode with f > rate / 10

    level    (samples,)  drive, scaled to -1 .. 1
    least    rows behind every step, whatever the modes
    returned (rows,)     in order
    """
    step = np.abs(np.diff(level))
    padded = np.pad(step, 3)
    neighbour = np.maximum(padded[:-6], padded[6:])
    steps = np.flatnonzero((step > JUMP) & (step > 4.0 * neighbour))
    count = least
    for mode in extensions:
        if isinstance(mode, LinearMode) and mode.frequency_Hz > RESOLVED * rate_Hz:
            lasts_s = DECAYS * mode.quality / (pi * mode.frequency_Hz)
            count = max(count, ceil(lasts_s * rate_Hz))
    rows = np.unique(steps[:, None] + 1 + np.arange(count))
    return np.asarray(rows[rows < len(level)], dtype=np.intp)
