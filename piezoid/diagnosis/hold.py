"""Hold: what reaches stage and sensor where every row is a value that the converter held.

At the converter's own rate a command is a staircase, and at the next sample two poles make of it

    y[k] = sum_i c_i h_i[k],  h_i[k] = p_i h_i[k-1] + (1 - p_i) u[k-1],  p_i = exp(-w_i T),
    c_1 = w_2 / (w_2 - w_1),  c_2 = -w_1 / (w_2 - w_1),

which no line between samples knows: it is 2 per cent off where a period has 13 samples.

Source: Franklin, Powell & Workman, Digital Control of Dynamic Systems (1998), step invariance.
"""

import numpy as np

from piezoid.identification.hysteresis.pieces import Rig
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import recursive_filter

SAME = 0.01  # of the clock: so near a recording's rate is the converter's own
APART = 1e-4  # of a pole: nearer ones are one


def is_held(rate_Hz: float, clock_Hz: float | None, rig: Rig) -> bool:
    """Tell whether rows are the converter's own values and a pole of the chain is known."""
    known = rig.amplifier_bandwidth_Hz is not None or rig.sensor_bandwidth_Hz is not None
    return known and clock_Hz is not None and abs(rate_Hz / clock_Hz - 1.0) < SAME


def held(command: Array, poles_Hz: tuple[float | None, ...], rate_Hz: float) -> Array:
    """Return a staircase behind up to two poles, at its own samples."""
    rates = [2.0 * np.pi * pole for pole in poles_Hz if pole is not None]
    if not rates:
        return np.concatenate([command[:1], command[:-1]])
    if len(rates) == 1:
        return _behind(command, rates[0] / rate_Hz)
    first, second = rates
    if abs(second / first - 1.0) < APART:
        second = first * (1.0 + APART)
    share = second / (second - first)
    return np.asarray(
        share * _behind(command, first / rate_Hz)
        + (1.0 - share) * _behind(command, second / rate_Hz)
    )


def _behind(command: Array, ratio: float) -> Array:
    pole = float(np.exp(-ratio))
    moved = recursive_filter([0.0, 1.0 - pole], [1.0, -pole], command - command[0])
    return np.asarray(moved + command[0])
