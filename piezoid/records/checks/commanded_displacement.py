"""Report a displacement that was not measured: a command, or a column computed from the drive.

Sorted by the drive, a displacement computed from it never falls. A measured one falls because of
its noise and, between rising and falling branches, its hysteresis.
"""

import numpy as np

from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from piezoid.statement import Statement, finding

# Share of samples below an earlier one: at least 0.28 in 20 measured or simulated recordings that
# go up and down, 1e-4 in a command on a grid of 12 bits behind a drive of six decimals.
MAX_FALLING = 0.03
MAX_SHIFT = 2  # samples between a command and its output as the drive
MIN_LEVELS = 100  # the hysteresis of a coarser reading may be smaller than a step
MIN_BRANCH = 0.2  # of the samples, rising and falling: the displacement of one branch never falls


def check_commanded_displacement(recording: Recording, axis: str) -> list[Statement]:
    """Report a displacement that is a function of the drive to the last digit."""
    drive_V, displacement_m = recording.voltage_V(axis), recording.displacement_m(axis)
    if not is_function_of(drive_V, displacement_m):
        return []
    gain_m_per_V = float(np.ptp(displacement_m) / np.ptp(drive_V))
    text = (
        "The displacement is a function of the drive to the last digit, about "
        f"{with_unit(gain_m_per_V, 'm')}/V times the drive, rising and falling: it is a command "
        "or was computed from the drive, and nothing was measured."
    )
    return [finding("not_measured", text, axis=axis)]


def is_function_of(drive: Array, displacement: Array) -> bool:
    """Return whether a displacement is an increasing function of its drive, without hysteresis.

    drive, displacement  (samples,)  any unit
    """
    steps = np.diff(drive)
    branches = np.mean(steps > 0.0), np.mean(steps < 0.0)
    if min(branches) < MIN_BRANCH or len(np.unique(displacement)) < MIN_LEVELS:
        return False
    for shift in range(-MAX_SHIFT, MAX_SHIFT + 1):
        stop = len(drive) - abs(shift)
        v, y = drive[max(-shift, 0) :][:stop], displacement[max(shift, 0) :][:stop]
        sign = np.sign(np.dot(v - v.mean(), y - y.mean()))
        # A stable sort keeps the order in time at equal drive, to show the noise in a hold.
        by_drive = sign * y[np.argsort(v, kind="stable")]
        if np.mean(by_drive < np.maximum.accumulate(by_drive)) < MAX_FALLING:
            return True
    return False
