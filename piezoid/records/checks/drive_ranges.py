"""Report recordings with a much smaller drive than the widest recording."""

from collections.abc import Sequence

import numpy as np

from piezoid.formatting import with_unit
from piezoid.records.recording import Recording
from piezoid.statement import Statement, finding

MIN_RANGE = 0.01  # of the widest drive; a smaller one shows nothing of the hysteresis


def check_drive_ranges(recordings: Sequence[Recording]) -> list[Statement]:
    """Compare the drive of each recording with the widest one of its axis."""
    statements = []
    for axis in sorted({r.axis for r in recordings}):
        drives = {r.name: r.voltage_V(axis) for r in recordings if axis in r.complete_axes}
        if len(drives) < 2:
            continue
        widest = max(drives, key=lambda name: float(np.ptp(drives[name])))
        widest_V = float(np.ptp(drives[widest]))
        for name, drive in drives.items():
            range_V = float(np.ptp(drive))
            if range_V <= MIN_RANGE * widest_V:
                text = (
                    f"{name}: the drive of axis {axis} moves by {with_unit(range_V, 'V')}, less "
                    f"than a hundredth of the {with_unit(widest_V, 'V')} of {widest}; it may show "
                    "the dynamics, but not the hysteresis."
                )
                statements.append(
                    finding(
                        "drive_range", text, axis=axis, recording=name, value=range_V, unit="V"
                    )
                )
    return statements
