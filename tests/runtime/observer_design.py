"""An observer design made here from its poles alone, for the runtime to run.

Amplifier 4 kHz, a mode at 630 Hz with damping 0.05, sensor 8.5 kHz, 20 kHz sampling.
"""

import numpy as np
from scipy.linalg import expm

RATE_Hz = 20e3


def plant():
    """Exact zero-order-hold model with unit static gain: A, B, C."""
    amplifier, mode, damping, sensor = 2 * np.pi * np.array([4e3, 630, 0.05 / 2 / np.pi, 8.5e3])
    continuous = np.array(
        [
            [-amplifier, 0, 0, 0],
            [0, 0, 1, 0],
            [mode**2, -(mode**2), -2 * damping * mode, 0],
            [0, sensor, 0, -sensor],
        ]
    )
    block = np.zeros((5, 5))
    block[:4, :4] = continuous / RATE_Hz
    block[0, 4] = amplifier / RATE_Hz
    held = expm(block)
    return held[:4, :4], held[:4, 4], np.array([0.0, 0, 0, 1])


def poles(frequencies_Hz, damping=1.0):
    """Sampled poles: a pair if the damping is below one."""
    w = 2 * np.pi * np.atleast_1d(frequencies_Hz) / RATE_Hz
    s = -w if damping == 1.0 else np.r_[-w * damping, -w * damping] + 0j
    if damping < 1.0:
        s = s + 1j * np.r_[w, -w] * np.sqrt(1 - damping**2)
    return np.exp(s)


def place(A, B, wanted):
    """Ackermann's formula: K with eig(A - B K) = wanted."""
    controllable = np.column_stack([np.linalg.matrix_power(A, i) @ B for i in range(len(A))])
    value = np.zeros_like(A)
    for coefficient in np.real(np.poly(wanted)):
        value = value @ A + coefficient * np.eye(len(A))
    return np.linalg.solve(controllable.T, np.eye(len(A))[-1]) @ value


def observer_parameters(gain_m_per_V=1.0):
    """The runtime's observer for a plant of this static gain; states in metres."""
    A, B, C = plant()
    feedback_poles = np.r_[poles(630, 0.9), poles([4e3, 8.5e3])]
    observer_poles = np.r_[poles(1200, 0.8), poles([800, 4200, 8600])]
    extended = np.block([[A, B[:, None]], [np.zeros((1, 4)), np.ones((1, 1))]])
    read = np.r_[C, 0.0]
    correction = place(extended.T, (read @ extended), observer_poles)
    K = place(A, B, feedback_poles)
    rest = np.linalg.solve(np.eye(4) - A, B)
    return {
        "observer_order": 4,
        "observer_A": A,
        "observer_B": B * gain_m_per_V,
        "observer_C": C,
        "observer_L": correction[:4],
        "observer_disturbance_L_V_per_m": correction[4] / gain_m_per_V,
        "observer_rest": rest * gain_m_per_V,
        "feedback_K_V": K / gain_m_per_V,
        "feedback_N_V_per_m": (1 + K @ rest) / (C @ rest) / gain_m_per_V,
        "gain_m_per_V": gain_m_per_V,
    }


class LinearPlant:
    """The same chain, stepped: ``measure`` before the voltage of the sample is known."""

    def __init__(self, gain=1.0):
        self.A, self.B, self.C = plant()
        self.gain = gain
        self.x = np.zeros(4)

    def measure(self):
        return float(self.C @ self.x)

    def drive(self, moved):
        """moved: gain times voltage, or what a hysteresis made of it."""
        self.x = self.A @ self.x + self.B * moved
