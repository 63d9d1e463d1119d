"""Displacement at constant drive or in a hold: trends, lines and residuals on left-out blocks."""

from collections.abc import Sequence

import numpy as np

from piezoid.diagnosis.blocked_regression import gain_z
from piezoid.diagnosis.segments import Places
from piezoid.numerics.arrays import Array

BLOCKS, FOLDS = 40, 5  # blocks of time, each fold every fifth of them
SAME_ERROR = 1.02  # ratio of rms errors up to which two trends are equivalent
MIN_Z = 3.3  # standard errors of the gain of blocks: as for every effect


def blocks_of(rows: int) -> Places:
    """Return the block of each row, (rows,)."""
    return np.arange(rows) * BLOCKS // rows


def held_out_residual(y: Array, parts: Sequence[Array]) -> Array:
    """Return the residual of columns and a constant on left-out blocks, (rows,)."""
    design = np.column_stack([np.ones(len(y)), *parts])
    residual, fold = np.empty(len(y)), blocks_of(len(y)) % FOLDS
    for out in range(FOLDS):
        inside = fold != out
        coefficient = np.linalg.lstsq(design[inside], y[inside], rcond=None)[0]
        residual[~inside] = y[~inside] - design[~inside] @ coefficient
    return residual


def gain_on_blocks(reference: Array, residual: Array) -> tuple[float, float]:
    """Return the relative reduction of the rms between two residuals, and its z over blocks."""
    block = blocks_of(len(reference))
    gain = 1.0 - float(np.sqrt(np.mean(residual**2) / max(float(np.mean(reference**2)), 1e-300)))
    gains = np.bincount(block, reference**2 - residual**2, BLOCKS).astype(np.float64)
    explained = np.bincount(block, (reference - residual) ** 2, BLOCKS).astype(np.float64)
    return gain, gain_z(gains, explained, gain)


def cubic(time_s: Array) -> Array:
    """Return a cubic of time, (rows, 3)."""
    unit = 2.0 * (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-30) - 1.0
    return np.column_stack([unit, unit**2, unit**3])


def waves(time_s: Array, frequencies_Hz: Sequence[float]) -> Array:
    """Return cosine and sine of each frequency, about their means, (rows, 2 frequencies)."""
    angles_rad = [2.0 * np.pi * frequency_Hz * time_s for frequency_Hz in frequencies_Hz]
    columns = np.column_stack([wave(angle) for angle in angles_rad for wave in (np.cos, np.sin)])
    return np.asarray(columns - columns.mean(axis=0))


def peak_Hz(signal: Array, time_s: Array, near_Hz: float, reach_Hz: float) -> float:
    """Return the frequency of a line of a signal, at the vertex of its power.

    With a frequency error of an eighth of a period over the recording, a fifth of the line would
    remain and be reported as a second line.
    """
    frequencies = near_Hz + reach_Hz * np.linspace(-1.0, 1.0, 41)
    power = np.array(
        [abs(np.exp(-2j * np.pi * f * time_s) @ signal) for f in frequencies.tolist()]
    )
    peak = int(np.clip(np.argmax(power), 1, len(frequencies) - 2))
    left, centre, right = power[peak - 1 : peak + 2].tolist()
    curvature = 2.0 * centre - left - right
    offset = 0.5 * (right - left) / curvature if curvature > 0.0 else 0.0
    step_Hz = frequencies[1] - frequencies[0]
    return float(frequencies[peak] + step_Hz * np.clip(offset, -1.0, 1.0))
