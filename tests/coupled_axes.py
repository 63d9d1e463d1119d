"""A constructed coupled stage of two axes and two modes."""

import numpy as np

from piezoid.identification.coupled.coupled_stage import CoupledStage

STATIC_M_PER_V = 3.5e-6 * np.array([[1.0, 0.12], [-0.08, 1.0]])
MODE_HZ, DAMPING = np.array([630.0, 720.0]), np.array([0.05, 0.05])
TURN = 0.3  # of the modes against the axes, which makes part of the coupling dynamic


def coupled_axes() -> CoupledStage:
    """Return G(s) = sum_m (G_0 q_m) q_m' w_m^2 / (s^2 + 2 d w_m s + w_m^2), without hysteresis."""
    q = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])
    residue = np.zeros((2, 6, 2, 2))
    for m in range(2):
        gain = np.outer(STATIC_M_PER_V @ q[:, m], q[:, m])
        residue[0, 2 + m] = -gain / np.sqrt(1.0 - DAMPING[m] ** 2)
    names = ("x", "y")
    return CoupledStage(
        inputs=names, outputs=names, sampling_rate_Hz=4000.0, band_Hz=(1.0, 1900.0),
        levels_V=np.array([0.1, 0.3]),
        log_frequency=np.stack([np.log(MODE_HZ), np.zeros(2)]),
        log_damping=np.stack([np.log(DAMPING), np.zeros(2)]),
        lag_Hz=np.array([1.0]), residue_m_per_V=residue, delay_s=0.0,
        replicate_frequency=np.zeros((1, 2, 2)),
        moved_rms_m=np.ones((2, 2)), noise_rms_m=np.zeros((2, 2)), error_rms_m=np.zeros((2, 2)),
        error_is_left_out=False,
    )  # fmt: skip
