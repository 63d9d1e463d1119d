"""Effect of an extension on a control loop: one record for design and verification."""

from dataclasses import dataclass

import numpy as np

from piezoid.operators.linear import ContinuousSystem


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopEffect:
    """Effect of one extension on a closed loop around the axis; by default none.

    system         linear, in series behind the hysteresis; None: nothing
    is_slow        that system relaxes over seconds: within a loop's band it is a gain between the
                   one at once, 1, and its gain at rest
    dead_time_s    pure delay
    gain           factor of the displacement at the end of the recordings, and so from now on
    low_V, high_V  range of the drive that reaches the ceramic
    slew_V_per_s   fastest change of the drive that reaches the ceramic
    activation_s   time constant with which the irreversible part follows; 0: at once
    activation_m   lag of that part beyond which it follows faster; 0: none is
    motion_m       half the range of motion that the drive does not cause
    motion_m_per_s its fastest change
    reading_m      largest error of the reading, which a loop takes for motion
    reading_Hz     frequency of that error where it has one of its own, 0 where it follows position
    """

    system: ContinuousSystem | None = None
    is_slow: bool = False
    dead_time_s: float = 0.0
    gain: float = 1.0
    low_V: float = -np.inf
    high_V: float = np.inf
    slew_V_per_s: float = np.inf
    activation_s: float = 0.0
    activation_m: float = 0.0
    motion_m: float = 0.0
    motion_m_per_s: float = 0.0
    reading_m: float = 0.0
    reading_Hz: float = 0.0


NOTHING = LoopEffect()
