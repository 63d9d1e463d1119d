"""Report an implausible gain: a wrong unit, or a drive recorded at a monitor output.

gain = range of the displacement / range of the drive
"""

import numpy as np

from piezoid.formatting import with_unit
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import noise_rms
from piezoid.statement import Statement, finding

# Gain per volt: tubes some nm, stacks 0.1 to 1 um, levers and benders 10 um; an objective 40 um
# per volt at the amplifier's input.
MIN_GAIN_m_per_V, MAX_GAIN_m_per_V = 1e-10, 5e-5
MIN_MOTION_NOISE = 20.0  # standard deviations of the noise; a smaller range may be noise alone


def check_gain(recording: Recording, axis: str) -> list[Statement]:
    """Report a gain outside ``MIN_GAIN_m_per_V`` to ``MAX_GAIN_m_per_V``; counts have no gain."""
    displacement_m = recording.displacement_m(axis)
    range_V, range_m = float(np.ptp(recording.voltage_V(axis))), float(np.ptp(displacement_m))
    is_motion = range_m > 0.0 and range_m >= MIN_MOTION_NOISE * noise_rms(displacement_m)
    if recording.counted or not range_V > 0.0 or not is_motion:
        return []
    gain_m_per_V = range_m / range_V
    if MIN_GAIN_m_per_V <= gain_m_per_V <= MAX_GAIN_m_per_V:
        return []
    text = (
        f"{with_unit(range_m, 'm')} for {with_unit(range_V, 'V')} is a gain of "
        f"{with_unit(gain_m_per_V, 'm')} per volt; stages have {with_unit(MIN_GAIN_m_per_V, 'm')} "
        f"to {with_unit(MAX_GAIN_m_per_V, 'm')} per volt. Check the units, and whether the drive "
        "is the output of a monitor."
    )
    return [finding("implausible_gain", text, axis=axis, value=gain_m_per_V, unit="m/V")]
