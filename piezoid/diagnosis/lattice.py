"""Lattice: the step of a coarse reading, whatever lies between its values.

Spikes, and what was put in their place, are off the lattice: a step that nearly all samples are
multiples of is looked for near the usual gap by the phases of all values, before it is asked
which step all values are multiples of.

Source: Rayleigh (1880) on phases that point together; Mardia & Jupp, Directional Statistics.
"""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.faults import step_size

DIGITS = 9
MOST_STEPS = 2000  # of a range: finer ones are nobody's cause
ON = 0.1  # of a step: so near is on the lattice
UNEVEN = 0.02  # of a step: what its last digit may be off
PHASES = 20  # tried for every one that the range can tell
MOST = 0.99  # of the samples: no more than the rest are spikes


def lattice_step(response: Array) -> float:
    """Return the step of a reading's lattice, 0 where it never rests on one."""
    if not np.any(np.diff(response) == 0):
        return 0.0
    values, count = np.unique(np.round(response, DIGITS), return_counts=True)
    usual = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    if MOST_STEPS * usual > values[-1] - values[0]:
        step = _step_near(usual, values)
        place = (values - values[np.argmax(count)]) / step
        if count[np.abs(place - np.round(place)) < ON].sum() > MOST * len(response):
            return step
    return step_size(np.round(response, DIGITS))


def _step_near(usual: float, values: Array) -> float:
    """Return the step near the usual one at which the phases of values point together most.

    Printed with few digits, steps are uneven by the last of them, and a mean of them is not fine
    enough to count hundreds by.
    """
    width = float(np.ptp(values)) / usual
    reversals = np.linspace(1.0 - UNEVEN, 1.0 + UNEVEN, int(2.0 * UNEVEN * width * PHASES) + 2)
    phase = np.exp(2j * np.pi * np.outer(reversals / usual, values))
    return usual / float(reversals[int(np.argmax(np.abs(phase.sum(axis=1))))])
