"""Tips at which the displacement stands while the drive goes on: something ends there.

    |y - y_tip| < 4 s  from v_begin to v_tip,    g (v_tip - v_begin) > max(20 s, 3 % of the range)

s is the noise and g the mean gain of the same branch up to there. Unlike a clipped reading, one
that scatters at its end may be true: it is told, and stays in the fit.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.records.faults import noise_rms, step_size
from piezoid.records.recording import Quantity, Recording
from piezoid.records.sweep import noise_of, reversals_of
from piezoid.statement import Statement, finding

WITHIN = 4.0  # times the noise
UNMOVED = 20.0  # times the noise, at the gain of the branch
SHARE = 0.03  # of the displacement's range; none in 936 healthy records of thirteen published laws
TIPS = 2  # at one level, which may drift: one alone may be a rest
JUMP = 0.25  # of the way: behind a step of the drive the displacement has yet to come
RISES = 0.8  # correlation of drive and displacement: a butterfly has no ends


def standing_tips(recording: Recording, axis: str) -> list[Statement]:
    """Tell a displacement that stands at the end of its range while the drive goes on."""
    drive = recording.find(Quantity.VOLTAGE, axis)
    response = recording.find(Quantity.DISPLACEMENT, axis)
    if drive is None or response is None or len(drive.values) < 50:
        return []
    v, y = drive.values, response.values
    if not np.ptp(v) > 0 or not np.ptp(y) > 0:
        return []
    correlation = float(np.corrcoef(v, y)[0, 1])
    if abs(correlation) < RISES:
        return []
    lost = np.zeros(len(v), dtype=bool)
    lost[list(recording.bridged)] = True
    found = []
    for end in (1.0, -1.0):
        stands = _stands(end * v, end * np.sign(correlation) * y, lost)
        if len(stands) >= TIPS:
            begins = end * np.array([begin for begin, _ in stands])
            tips = end * np.array([tip for _, tip in stands])
            farthest_V = float(end * (end * tips).max())
            text = (
                f"the displacement of {axis} stands within its noise at {len(stands)} tips, while "
                f"the drive goes on from {float(np.median(begins)):.4g} V "
                f"{'up' if end > 0 else 'down'} to {farthest_V:.4g} V: the amplifier, the sensor "
                "or the stage ends there, which is no hysteresis. Record with the drive inside, "
                "or leave those cycles out"
            )
            found.append(finding(quantity="stands", axis=axis, text=text))
    return found


def _stands(v: Array, y: Array, lost: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return where the drive was when the displacement stopped, and its tip, of upper tips."""
    noise = max(noise_rms(y), step_size(y))
    turns = (0, *reversals_of(v, max(noise_of(v), 0.02 * float(np.ptp(v)))))
    found, levels = [], []
    for start, tip in pairwise(turns):
        if v[tip] <= v[start] or tip - start < 10 or lost[start:tip].mean() > 0.2:
            continue
        level = float(np.median(y[tip - 4 : tip + 1]))
        moves = np.flatnonzero(np.abs(y[start:tip] - level) > WITHIN * noise)
        begin = start + (int(moves[-1]) + 1 if len(moves) else 0)
        steps = np.abs(np.diff(v[begin : tip + 1]))
        jumps = steps.max(initial=0.0) > JUMP * (v[tip] - v[begin])
        if begin - start < 5 or lost[begin:tip].any() or jumps:
            continue
        gain = (level - y[start]) / max(float(v[begin] - v[start]), 1e-12)
        if gain * (v[tip] - v[begin]) > max(UNMOVED * noise, SHARE * float(np.ptp(y))):
            found.append((float(v[begin]), float(v[tip])))
            levels.append(level)
    near = np.array(levels) > max(levels, default=0.0) - max(UNMOVED * noise, SHARE * np.ptp(y))
    return [one for one, here in zip(found, near.tolist(), strict=True) if here]
