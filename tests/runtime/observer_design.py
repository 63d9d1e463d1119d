"""An observer for the runtime, placed by its poles, and its plant.

Amplifier 4 kHz, a mode at 630 Hz with damping 0.05, sensor 8.5 kHz, 20 kHz sampling.
"""

from functools import cache

import numpy as np

from benchmarks.varied_chains import plant_from_chain
from piezoid.export.export_stage import observer_values
from tests.design.placed import place_observer
from tests.design.rig import lateral_chain, printed_observer_poles

RATE_Hz = 20e3


def poles(frequencies_Hz, damping=1.0):
    """Return sampled poles, in pairs if the damping is below one."""
    w = 2 * np.pi * np.atleast_1d(frequencies_Hz) / RATE_Hz
    s = -w if damping == 1.0 else np.r_[-w * damping, -w * damping] + 0j
    if damping < 1.0:
        s = s + 1j * np.r_[w, -w] * np.sqrt(1 - damping**2)
    return np.exp(s)


@cache
def plant():
    """Return the sampled chain with unit static gain."""
    return plant_from_chain(lateral_chain())


@cache
def unit_observer():
    feedback, observer = printed_observer_poles()
    return observer_values(
        place_observer(plant(), feedback_poles=feedback, observer_poles=observer)
    )


def observer_parameters(gain_m_per_V=1.0):
    """Return the observer of the runtime for a plant of this static gain; states in metres."""
    observer = unit_observer()
    scaled_up = {name: observer[name] * gain_m_per_V for name in ("observer_B", "observer_rest")}
    per_gain = ("observer_disturbance_L_V_per_m", "feedback_K_V", "feedback_N_V_per_m")
    scaled_down = {name: observer[name] / gain_m_per_V for name in per_gain}
    return {**observer, **scaled_up, **scaled_down, "gain_m_per_V": gain_m_per_V}


class LinearPlant:
    """The same chain, step by step: ``measure`` precedes ``drive`` in every sample."""

    def __init__(self):
        self.A, self.B, self.C = plant().realised()
        self.x = np.zeros(len(self.A))

    def measure(self):
        return float(self.C @ self.x)

    def drive(self, input_m):
        """Advance one sample; ``input_m`` is the voltage or the output of a hysteresis."""
        self.x = self.A @ self.x + self.B * input_m
