"""A known stage of three coupled axes, and its recordings as files.

    y = sum_m (G_0 q_m) q_m' w_m^2 / (s^2 + 2 d w_m s + w_m^2) v,   v = u + sum_r w_r P_r(u)

Q rotates the axes slightly, so the coupling is G_0 at low frequency and different near the modes.
"""

from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

RATE_HZ, SAMPLES, PERIODS = 2000.0, 2048, 3
AXES = ("x", "y", "z")
GAIN_M_PER_V = 1e-6 * np.array([[1.0, 0.12, -0.05], [0.08, 1.1, 0.06], [-0.04, 0.1, 0.9]])
MODE_HZ, DAMPING, TURN = (310.0, 405.0, 530.0), 0.02, 0.2
PLAY_V, WEIGHT = (0.02, 0.1, 0.4, 1.5), (0.04, 0.04, 0.05, 0.06)
LEVELS_V = (0.2, 0.6)
REALISATIONS = 5
REST_V = 5.0
NOISE_M = 2e-9
LAB = """[rig]
name = "three coupled axes"

[coupled]
axes = ["x", "y", "z"]

[acquisition]
sampling_rate_Hz = 10000
dac_bits = 16
adc_bits = 16
input_range_V = [0, 10]
"""


def plays(drive_V: np.ndarray) -> np.ndarray:
    """Return the drive behind the hysteresis of a ceramic that starts at its first voltage."""
    total = drive_V.copy()
    for half_width, weight in zip(PLAY_V, WEIGHT, strict=True):
        state, play = drive_V[0], np.empty(len(drive_V))
        for k, value in enumerate(drive_V.tolist()):
            state = max(value - half_width, min(value + half_width, state))
            play[k] = state
        total += weight * play
    return total


def displacement_m(drives_V: np.ndarray, seed: int) -> np.ndarray:
    """Return the displacements, (samples, axes), from rest."""
    v = np.stack([plays(column) for column in drives_V.T], axis=1)
    rotation = np.eye(3)
    for a, b in ((0, 1), (1, 2)):
        plane_rotation = np.eye(3)
        plane_rotation[[a, a, b, b], [a, b, a, b]] = (
            np.cos(TURN),
            -np.sin(TURN),
            np.sin(TURN),
            np.cos(TURN),
        )
        rotation = rotation @ plane_rotation
    total = np.zeros_like(v)
    for m, mode_Hz in enumerate(MODE_HZ):
        w = 2 * np.pi * mode_Hz
        top, bottom, _ = cont2discrete(
            ([w**2], [1.0, 2 * DAMPING * w, w**2]), 1 / RATE_HZ, method="foh"
        )
        force = (v - v[0]) @ rotation[:, m]
        response = lfilter(top.ravel(), bottom, force)
        total += np.outer(response, GAIN_M_PER_V @ rotation[:, m])
    noise = NOISE_M * np.random.default_rng(seed).standard_normal(total.shape)
    return total + v[0] @ GAIN_M_PER_V.T + noise


def multisine(level_V: float, seed: int) -> np.ndarray:
    """Return a periodic drive of all axes about the centre, (samples, axes)."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros((SAMPLES // 2 + 1, 3), dtype=complex)
    lines = np.arange(2, 750)
    spectrum[lines] = np.exp(2j * np.pi * rng.random((len(lines), 3)))
    drive = np.fft.irfft(spectrum, SAMPLES, axis=0)
    return REST_V + np.tile(level_V * drive / drive.std(), (PERIODS, 1))


def sweep(moving: tuple[int, ...], seed: int) -> np.ndarray:
    """Return slow loops of decreasing size of some axes, the others at constant voltage."""
    time_s = np.arange(int(4 * RATE_HZ)) / RATE_HZ
    drives = np.full((len(time_s), 3), REST_V)
    for axis in moving:
        turns_Hz = 1.0 + 0.37 * axis * (len(moving) > 1)
        size = 4.5 * np.where(time_s < 2.0, 1.0, 0.5)
        drives[:, axis] = REST_V - size * np.sin(2 * np.pi * turns_Hz * time_s + 0.1 * seed)
    lead = np.linspace(0.0, 1.0, int(0.5 * RATE_HZ))[:, None]
    return np.concatenate([REST_V + lead * (drives[:1] - REST_V), drives])


def write_recording(path: Path, drives_V: np.ndarray, seed: int) -> Path:
    """Write the recording of these drives."""
    displacement_um = 1e6 * displacement_m(drives_V, seed)
    heading = ["time [s]", *(f"voltage_{a} [V]" for a in AXES)]
    heading += [f"displacement_{a} [um]" for a in AXES]
    time_s = np.arange(len(drives_V)) / RATE_HZ
    rows = np.column_stack([time_s, drives_V, displacement_um])
    np.savetxt(path, rows, fmt="%.7f", delimiter=",", header=",".join(heading), comments="")
    return path


def campaign(folder: Path, axes: tuple[str, ...] = AXES) -> list[Path]:
    """Write lab.toml, multisines of all axes at two levels, and loops of single axes."""
    (folder / "lab.toml").write_text(LAB)
    files = [
        write_recording(folder / f"all_{level}_{r}.csv", multisine(level_V, 10 * level + r), r)
        for level, level_V in enumerate(LEVELS_V)
        for r in range(REALISATIONS)
    ]
    for axis in axes:
        k = AXES.index(axis)
        files.append(write_recording(folder / f"{axis}_loops.csv", sweep((k,), 1), 20 + k))
        files.append(write_recording(folder / f"{axis}_check.csv", sweep((k,), 5), 30 + k))
    return files
