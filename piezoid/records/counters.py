"""Clocks that are counters of few bits: they begin anew, and no time goes back."""

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array

_BITS = (16, 24, 32)
_TICKS_s = (1e-3, 1e-6)  # of counters that are told in another unit: milliseconds, microseconds
_NEAR = 2.5  # intervals by which a counter may miss its last value, or its first


def unwrapped(time_s: Array, factor: float) -> tuple[Array, NDArray[np.intp], int]:
    """Return stamps that go on where a counter of 16, 24 or 32 bits began anew.

        t_k <- t_k + 2^bits * tick * (wraps up to k)

    time_s    (rows,)  s, NaN kept
    factor    seconds of one unit of the column, one of the ticks that are tried
    returned  stamps, the rows at which it began anew, and its bits; as they were, none and 0
              where no counter explains every step back

    The last stamp in front of a wrap must lie at the counter's end and the next at its beginning,
    0 or the lowest number with a sign: a clock that was set back is none.
    """
    stamped = np.flatnonzero(np.isfinite(time_s))
    steps = np.diff(time_s[stamped])
    back = np.flatnonzero(steps < 0)
    interval_s = float(np.median(steps)) if len(steps) else 0.0
    none = time_s, np.zeros(0, dtype=np.intp), 0
    if not len(back) or not interval_s > 0:
        return none
    last_s, first_s = time_s[stamped[back]], time_s[stamped[back + 1]]
    for tick_s in (factor, *_TICKS_s):
        for bits in _BITS:
            turn_s = 2.0**bits * tick_s
            goes_on = np.abs(steps[back] + turn_s - interval_s) < _NEAR * interval_s
            for low_s in (0.0, -turn_s / 2):
                begins = np.abs(first_s - low_s) < _NEAR * interval_s
                ends = np.abs(last_s - low_s - turn_s) < _NEAR * interval_s
                if (goes_on & begins & ends).all():
                    found = time_s.copy()
                    rows = stamped[back + 1]
                    for row in rows.tolist():
                        found[row:] += turn_s
                    return found, rows, bits
    return none
