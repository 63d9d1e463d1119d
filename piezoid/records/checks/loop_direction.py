"""Report a loop that turns against the direction of hysteresis and lag.

    A = sgn(r) * closed integral of v dy / (range v * range y * cycles),   r correlation of v and y

A is positive for hysteresis and for any lag. Only narrow loops are tested, since above a resonance
any phase is possible.
"""

import json

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

# Share of their box that loops enclose: 4.3 to 7.7 % for thirteen published laws (negative with
# exchanged columns), 3.4 to 7.8 % for the bundled stage; a lag makes loops wider.
MIN_AREA = 0.01
MIN_CORRELATION = 0.9  # at least 0.986 for the same loops


def check_loop_direction(recording: Recording, axis: str) -> list[Statement]:
    """Report a displacement that leads its drive: exchanged columns, or a drive sampled late."""
    area = loop_area(recording.voltage_V(axis), recording.displacement_m(axis))
    if area > -MIN_AREA:
        return []
    drive, response = (
        json.dumps(channel.label)
        for quantity in (Quantity.VOLTAGE, Quantity.DISPLACEMENT)
        if (channel := recording.find(quantity, axis)) is not None
    )
    text = (
        f"The displacement leads the drive; the loop encloses {100 * -area:.2g} % of its "
        "box in the wrong direction. If the headings are exchanged, write columns = "
        f"{{ voltage = {response}, displacement = {drive}, ... }} into lab.toml; else check "
        "whether the drive is sampled late."
    )
    return [finding("leads", text, axis=axis, value=area, unit="1")]


def loop_area(drive: Array, displacement: Array) -> float:
    """Return the enclosed area A over whole cycles, 0 without a narrow loop."""
    middle = 0.5 * float(drive.max() + drive.min())
    rises = np.flatnonzero((drive[:-1] < middle) & (drive[1:] >= middle))
    if len(rises) < 2:
        return 0.0
    cycles = slice(int(rises[0]), int(rises[-1]) + 1)
    v, y = (values[cycles] - values[cycles].mean() for values in (drive, displacement))
    if not np.ptp(v) > 0.0 or not np.ptp(y) > 0.0:
        return 0.0
    correlation = float(np.corrcoef(v, y)[0, 1])
    if abs(correlation) < MIN_CORRELATION:
        return 0.0
    count = float(np.abs(np.diff(v)).sum() / (2.0 * np.ptp(v)))
    area = float(np.sum(0.5 * (v[1:] + v[:-1]) * np.diff(y)))
    return float(np.sign(correlation)) * area / (float(np.ptp(v) * np.ptp(y)) * count)
