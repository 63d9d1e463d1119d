"""Data for the examples of public docstrings, beyond the lines of the package docstring."""

import numpy as np

import piezoid
from piezoid.numerics.arrays import Array

RATE_Hz, SAMPLES, REALISATIONS = 1000.0, 512, 4
MODE_Hz, DAMPING, GAIN_m_per_V = 60.0, 0.05, 1e-6


def coupled_data() -> dict[str, object]:
    """Return ``levels`` of one drive for a coupled stage."""
    rng = np.random.default_rng(0)
    levels = [_level(level_V, rng) for level_V in (0.1, 0.3)]
    return {"levels": levels}


def simulate_mode(drive_V: Array) -> Array:
    f = np.arange(len(drive_V) // 2 + 1) * RATE_Hz / len(drive_V)
    mode = MODE_Hz**2 / (MODE_Hz**2 - f**2 + 2j * DAMPING * MODE_Hz * f)
    return GAIN_m_per_V * np.fft.irfft(mode * np.fft.rfft(drive_V), len(drive_V))


def _level(level_V: float, rng: np.random.Generator) -> piezoid.PeriodicData:
    drive_V = np.zeros((SAMPLES, 1, REALISATIONS, 1))
    displacement_m = np.zeros_like(drive_V)
    for k in range(REALISATIONS):
        spectrum = np.zeros(SAMPLES // 2 + 1, dtype=complex)
        spectrum[1:200] = np.exp(2j * np.pi * rng.random(199))
        waveform_V = np.fft.irfft(spectrum, SAMPLES)
        drive_V[:, 0, k, 0] = level_V * waveform_V / waveform_V.std()
        displacement_m[:, 0, k, 0] = simulate_mode(
            drive_V[:, 0, k, 0]
        ) + 1e-11 * rng.standard_normal(SAMPLES)
    return piezoid.PeriodicData(
        sampling_rate_Hz=RATE_Hz,
        inputs=("x",),
        outputs=("x",),
        voltage_V=drive_V,
        displacement_m=displacement_m,
    )
