"""Report recordings that were joined in one file: a jump of a drive that moves on both sides.

The rows behind such a jump contain a step response, which a fit takes for hysteresis or a mode. A
step from a rest or to a rest is deliberate, as are several steps.
"""

import numpy as np

from piezoid.formatting import significant, with_unit
from piezoid.records.drive_signal import isolated_steps
from piezoid.records.recording import Recording
from piezoid.statement import Statement, finding

JOINED = "joined_recordings"
# With these values nothing is reported in 269 recordings of 80 stages of five simulators, nor in
# measured ones; three files of joined sweeps have ratios of 15 to 75.
MIN_RATIO = 10.0  # jump over the largest other step of the drive
MAX_JUMP = 0.9  # of the range of the drive: a larger jump may be the flyback of a sawtooth
WINDOW = 20  # samples on either side, in which the drive moves
MIN_SPEED = 0.3  # of the mean speed: a slower drive rests


def check_joined_recordings(recording: Recording, axis: str) -> list[Statement]:
    """Report the only jump of a drive that moves before and after it."""
    drive_V = recording.voltage_V(axis)
    range_V = float(np.ptp(drive_V))
    if not range_V > 0.0:
        return []
    level = (2.0 * drive_V - drive_V.max() - drive_V.min()) / range_V
    jumps = [
        (piece, piece.start + sample)
        for piece in recording.pieces
        for sample in isolated_steps(level[piece]).tolist()
    ]
    if len(jumps) != 1:
        return []
    piece, sample = jumps[0]
    first, stop = sample - WINDOW, sample + 1 + WINDOW
    if first < piece.start or stop >= piece.stop:
        return []
    steps_V = np.concatenate([np.abs(np.diff(drive_V[p])) for p in recording.pieces])
    largest_V, jump_V = np.sort(steps_V)[-2:].tolist()
    sides_V = abs(drive_V[sample] - drive_V[first]), abs(drive_V[stop] - drive_V[sample + 1])
    is_moving = min(sides_V) > MIN_SPEED * WINDOW * float(steps_V.mean())
    if not is_moving or jump_V < MIN_RATIO * largest_V or jump_V > MAX_JUMP * range_V:
        return []
    instant_s = (sample + 1) / recording.sampling_rate_Hz
    text = (
        f"The drive jumps by {with_unit(jump_V, 'V')} within one sample at {instant_s:.4g} s, "
        f"{significant(jump_V / largest_V, 2)} times its largest other step. If two recordings "
        "were joined there, store them in two files."
    )
    return [finding(JOINED, text, axis=axis, value=jump_V, unit="V")]
