"""Report recordings whose drive hardly moves, or never meets that of the widest recording."""

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
        low_V, high_V = float(drives[widest].min()), float(drives[widest].max())
        for name, drive in drives.items():
            min_V, max_V = float(drive.min()), float(drive.max())
            if max_V - min_V <= MIN_RANGE * (high_V - low_V):
                text = (
                    f"{name}: the drive of axis {axis} moves by {with_unit(max_V - min_V, 'V')}, "
                    f"less than a hundredth of the {with_unit(high_V - low_V, 'V')} of {widest}; "
                    "it shows nothing of the hysteresis."
                )
            elif min_V > high_V or max_V < low_V:
                text = (
                    f"{name}: the drive of axis {axis} ({with_unit(min_V, 'V')} to "
                    f"{with_unit(max_V, 'V')}) never meets that of {widest} "
                    f"({with_unit(low_V, 'V')} to {with_unit(high_V, 'V')}). If an offset is "
                    "missing, write offset = { voltage = ... } into its [[recording]]."
                )
            else:
                continue
            statements.append(
                finding(quantity="drive_range", axis=axis, recording=name, text=text)
            )
    return statements
