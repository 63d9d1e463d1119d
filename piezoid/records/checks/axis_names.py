"""Ask whether recordings under the name x, which no heading states, are of another axis.

The axis x is also the default of a file without axis, and of entries to complete in lab.toml.
"""

import re
from collections.abc import Sequence

import numpy as np

from piezoid.records.column_roles import meaning_of
from piezoid.records.recording import Recording
from piezoid.records.units import heading_of
from piezoid.statement import Statement, finding

DEFAULT = "x"
# Of the range of the displacement: loops are 0.05 to 0.2 wide, and zeros and gains of two axes
# rarely agree to that.
MAX_DIFFERENCE = 0.15
MIN_OVERLAP = 0.5  # of the smaller range of the two drives


def check_axis_names(recordings: Sequence[Recording]) -> list[Statement]:
    """Report an axis x without a heading of its own that moves like an axis with a heading."""
    complete = [r for r in recordings if r.axis in r.complete_axes and _range_V(r) > 0.0]
    of_default = [r for r in complete if r.axis == DEFAULT]
    axes = sorted({r.axis for r in complete} - {DEFAULT})
    has_shared = any(len(r.complete_axes) > 1 for r in complete)
    if not of_default or len(axes) != 1 or has_shared or any(map(_states_axis, of_default)):
        return []
    (axis,) = axes
    of_axis = [r for r in complete if r.axis == axis]
    if not all(map(_states_axis, of_axis)):
        return []
    if not _is_alike(max(of_default, key=_range_V), max(of_axis, key=_range_V)):
        return []
    names = ", ".join(r.name for r in of_default)
    text = (
        f"No heading of {names} names an axis, so it is read as {DEFAULT}. Its displacement is "
        f"that of axis {axis} at the same drive. If both are one axis, write axis = "
        f'"{axis}" into its [[recording]] of lab.toml.'
    )
    return [finding("axis_names", text, axis=DEFAULT, recording=of_default[0].name)]


def _states_axis(recording: Recording) -> bool:
    """Return whether a heading, or the name of the file, names the axis of a recording."""
    axis = recording.axis
    headings = [meaning_of(heading_of(c.label)).axis for c in recording.channels if c.axis == axis]
    is_in_name = re.search(rf"(?<![a-zA-Z]){re.escape(axis)}(?![a-zA-Z])", recording.name)
    return axis in headings or is_in_name is not None


def _range_V(recording: Recording) -> float:
    return float(np.ptp(recording.voltage_V(recording.axis)))


def _is_alike(first: Recording, second: Recording) -> bool:
    """Return whether straight lines through both recordings agree over their common drive."""
    drives_V = [r.voltage_V(r.axis) for r in (first, second)]
    displacements_m = [r.displacement_m(r.axis) for r in (first, second)]
    low_V, high_V = max(map(np.min, drives_V)), min(map(np.max, drives_V))
    if high_V - low_V < MIN_OVERLAP * min(map(np.ptp, drives_V)):
        return False
    lines = [np.polyfit(u, y, 1) for u, y in zip(drives_V, displacements_m, strict=True)]
    difference_m = np.polyval(lines[0] - lines[1], [low_V, high_V])
    max_m = MAX_DIFFERENCE * min(map(np.ptp, displacements_m))
    return bool(np.abs(difference_m).max() < max_m)
