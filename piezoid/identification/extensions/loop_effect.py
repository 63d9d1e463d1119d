"""Effect of an extension on a control loop: one record for design and verification."""

from dataclasses import dataclass

import numpy as np

from piezoid.operators.linear import ContinuousSystem


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopEffect:
    """Effect of one extension on a closed loop around the axis; by default none.

    system         linear system in series behind the hysteresis, or None
    is_slow        whether the system relaxes over seconds: within the bandwidth of a loop it is a
                   gain between 1, at high frequency, and its static gain
    dead_time_s    pure delay
    gain           factor of the displacement after the recordings
    low_V, high_V  range of the drive that reaches the ceramic
    slew_V_per_s   fastest change of the drive that reaches the ceramic
    activation_s   time constant of the irreversible part; 0: no delay
    activation_m   lag of the irreversible part beyond which it relaxes faster; 0: at no lag
    motion_m       half the range of motion that the drive does not cause
    motion_m_per_s fastest change of that motion
    reading_m      largest error of the reading, which a loop converts to motion
    reading_Hz     frequency of that error; 0 if it is a function of position
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
