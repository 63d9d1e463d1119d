"""The fine steering mirror: three piezos, three displacements, one model for all levels.

M. Floren et al., ISMA-USD 2024, pp. 2042-2052; data CC BY 4.0. The levels of 100 and 300 mV are
available, the 200 mV level and the official test files are not. Every realisation is left out
once, in both levels. The model is simulated from the drive, in the steady state.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import piezoid
from benchmarks.records.steering_mirror.distortion import DistortedStage, fit_distorted

NAME = "mirror"
FOLDER = "steering_mirror"
RATE_HZ = 6400.0
AXES = ("1", "2", "3")
LEVELS = ("100mV", "300mV")
PAIRS = 21
PUBLISHED = (
    ("published: one black-box model, 28 states", "6.37", "4.19"),
    ("published: linear, one for each level", "8.38", "5.63"),
)
GAIN_HZ = (10.0, 100.0, 300.0)
STUDENT_95 = 2.571  # five degrees of freedom: six realisations


def read(folder: Path, level: str) -> piezoid.PeriodicData:
    """Read one level."""
    return piezoid.PeriodicData(
        sampling_rate_Hz=RATE_HZ,
        inputs=AXES,
        outputs=AXES,
        voltage_V=np.load(folder / f"u_{level}_train.npy"),
        displacement_m=np.load(folder / f"y_{level}_train.npy"),
    )


def errors(
    model: DistortedStage | piezoid.CoupledStage, data: piezoid.PeriodicData, realisation: int
) -> tuple[float, float]:
    """Return the relative rms error per measured period, and against the mean of the periods."""
    drive_V = data.voltage_V[:, :, realisation].mean(axis=2)
    position_m = data.displacement_m[:, :, realisation]
    position_m = position_m - position_m.mean(axis=0)
    linear = isinstance(model, piezoid.CoupledStage)
    simulated_m = model.simulate(drive_V, periodic=True) if linear else model.simulate(drive_V)
    error_m = position_m - simulated_m[:, :, None]
    mean = np.sum(error_m.mean(axis=2) ** 2) / np.sum(position_m.mean(axis=2) ** 2)
    return float(np.sqrt(np.sum(error_m**2) / np.sum(position_m**2))), float(np.sqrt(mean))


def noise(data: piezoid.PeriodicData, realisation: int) -> float:
    """Return the relative rms noise of one period, from the difference of two periods."""
    position_m = data.displacement_m[:, :, realisation]
    difference_m = position_m[..., 0] - position_m[..., 1]
    return float(np.sqrt(0.5 * np.sum(difference_m**2) / np.sum(position_m.mean(axis=2) ** 2)))


def response_error(data: piezoid.PeriodicData, held_out: int) -> float:
    """Return the relative rms error of a measured frequency response on a held-out realisation."""
    lines = data.excited_lines()
    U, Y = (spectrum.mean(axis=3) for spectrum in data.spectra(lines))
    training = [r for r in range(U.shape[2]) if r != held_out]
    adjoint = U[..., training].conj().transpose(0, 2, 1)
    G = Y[..., training] @ adjoint @ np.linalg.inv(U[..., training] @ adjoint)
    error = Y[..., held_out] - np.einsum("foi,fi->fo", G, U[..., held_out])
    return float(np.linalg.norm(error) / np.linalg.norm(Y[..., held_out]))


def gain_change(model: piezoid.CoupledStage) -> np.ndarray:
    """Return the relative change of the gain from the smallest to the largest level."""
    low, high = (model.response(GAIN_HZ, float(a)) for a in model.levels_V)
    return np.linalg.norm(high, axis=(1, 2)) / np.linalg.norm(low, axis=(1, 2)) - 1.0


def report(folder: Path) -> Iterator[str]:
    """Yield the table line by line."""
    levels = [read(folder, level) for level in LEVELS]
    count = levels[0].voltage_V.shape[2]
    start_s = time.process_time()
    all_realisations = fit_distorted(levels, PAIRS)
    training_s = time.process_time() - start_s
    yield "Steering mirror: relative rms in percent, each realisation left out once"
    yield f"{'left out':>10}" + "".join(
        f"{f'{level} period / mean (noise)':>34}" for level in LEVELS
    )
    models, table = [], []
    for r in range(count):
        training = [k for k in range(count) if k != r]
        models.append(fit_distorted([level.select(training) for level in levels], PAIRS))
        row = [(*errors(models[r], level, r), noise(level, r)) for level in levels]
        table.append(row)
        cells = (f"{100 * p:.2f} / {100 * m:.2f} ({100 * n:.2f})" for p, m, n in row)
        yield f"{r + 1:>10}" + "".join(f"{cell:>34}" for cell in cells)
    percent = 100 * np.array(table)
    rms, median = np.sqrt((percent**2).mean(axis=0)), np.median(percent, axis=0)
    measured = np.array([[response_error(level, r) for level in levels] for r in range(count)])
    linear = np.array(
        [[errors(models[r].linear, level, r)[0] for level in levels] for r in range(count)]
    )
    rows = [
        ("with distortion, per period, rms of all", *(f"{v:.2f}" for v in rms[:, 0])),
        ("with distortion, per period, median", *(f"{v:.2f}" for v in median[:, 0])),
        ("with distortion, against the mean, rms", *(f"{v:.2f}" for v in rms[:, 1])),
        ("  its linear part alone, rms", *(f"{100 * v:.2f}" for v in _rms(linear))),
        ("measured frequency response", *(f"{100 * v:.2f}" for v in _rms(measured))),
        ("noise of a period, rms", *(f"{v:.2f}" for v in rms[:, 2])),
        *PUBLISHED,
    ]
    for name, low, high in rows:
        yield f"{name:<46}{low:>8}{high:>8}"
    yield f"training, all realisations: {training_s:.0f} s of processor time"
    yield from _level_changes(all_realisations.linear, [model.linear for model in models])


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


def _level_changes(
    model: piezoid.CoupledStage, replicates: list[piezoid.CoupledStage]
) -> Iterator[str]:
    """Yield the changes with the level, with intervals by the jackknife over realisations."""
    low, high = (float(a) for a in model.levels_V)
    frequencies = []
    for replicate in replicates:  # modes of the replicate nearest to those of the model
        distance = np.abs(model.log_frequency[0][:, None] - replicate.log_frequency[0])
        frequencies.append(replicate.log_frequency[:, distance.argmin(axis=1)])
    jackknifed = replace(model, replicate_frequency=np.stack(frequencies))
    yield f"modes at {low:.3f} and {high:.3f} V rms, Hz; change in percent [95 %]; damping"
    for at_low, at_high, change, zl, zh in zip(
        model.mode_frequency_Hz(low),
        model.mode_frequency_Hz(high),
        100 * jackknifed.frequency_change(),
        model.mode_damping(low),
        model.mode_damping(high),
        strict=True,
    ):
        yield (
            f"{at_low:9.1f}{at_high:9.1f}   {change[0]:6.2f} [{change[1]:6.2f}, {change[2]:6.2f}]"
            f"   {zl:.4f} {zh:.4f}"
        )
    gains = np.stack([gain_change(replicate) for replicate in replicates])
    half_width = STUDENT_95 * np.sqrt(
        (len(gains) - 1) / len(gains) * ((gains - gains.mean(axis=0)) ** 2).sum(axis=0)
    )
    for f, value, width in zip(GAIN_HZ, gain_change(model), half_width, strict=True):
        yield f"gain at {f:.0f} Hz: {100 * value:+.2f} % [+-{100 * width:.2f}] from low to high"
