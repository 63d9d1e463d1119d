"""Rows after isolated steps of the drive, whose instants between samples are unknown."""

from collections.abc import Sequence
from math import ceil, pi

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.numerics.arrays import Array, Samples

MIN_STEP = 0.03  # half ranges in one sample
ISOLATION = 4.0  # step over its neighbours
RESOLVED = 0.1  # of the sampling rate: within a sample the phase of the ringing turns 36 degrees
DECAY_TIMES = 8.0  # time constants of the ringing, after which 3e-4 remain


def rows_after_steps(
    level: Array, rate_Hz: float, extensions: Sequence[Extension] = (), *, min_rows: int = 0
) -> Samples:
    """Return the rows that depend on the instant of an isolated step within its sample.

        n = max(min_rows, 8 Q rate / (pi f))    rows after a step, for a mode with f > rate / 10

    level     (samples,)  drive, scaled to -1 .. 1
    min_rows  minimum number of rows after every step
    returned  (rows,)     in order
    """
    step = np.abs(np.diff(level))
    padded = np.pad(step, 3)
    neighbour = np.maximum(padded[:-6], padded[6:])
    steps = np.flatnonzero((step > MIN_STEP) & (step > ISOLATION * neighbour))
    count = min_rows
    for mode in extensions:
        if isinstance(mode, LinearMode) and mode.frequency_Hz > RESOLVED * rate_Hz:
            decay_s = DECAY_TIMES * mode.quality / (pi * mode.frequency_Hz)
            count = max(count, ceil(decay_s * rate_Hz))
    rows = np.unique(steps[:, None] + 1 + np.arange(count))
    return np.asarray(rows[rows < len(level)], dtype=np.intp)
