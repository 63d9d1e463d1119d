"""Bouc-Wen ceramic, 0 to 100 V, about 11 um: no sum of plays represents its loops."""

import numpy as np

NOISE_um = 4e-3


def bouc_wen_um(drive_V: np.ndarray) -> np.ndarray:
    state, reading_um = 0.0, []
    steps = np.diff(drive_V, prepend=drive_V[0])
    for drive, step in zip(drive_V, steps, strict=True):
        state += 0.035 * step - 0.030 * abs(step) * state - 0.012 * step * abs(state)
        reading_um.append(0.1 * drive + 1.2e-4 * drive**2 - 0.6 * state)
    return np.array(reading_um)
