"""The fine steering mirror: three piezos, three displacements, one model for all levels.

M. Floren et al., ISMA-USD 2024, pp. 2042-2052; data CC BY 4.0. Levels of 100 and 300 mV are at
hand; the 200 mV level and the official test files are not. Every realisation is left out once, of
both levels at a time; the model is simulated from its drive alone, in the steady state.
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import piezoid
from benchmarks.structure_choice import relative_rms
from piezoid.identification.dynamics.periodic_estimate import estimate_response

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
    model: piezoid.CoupledStage, data: piezoid.PeriodicData, realisation: int
) -> tuple[float, float]:
    """Return the relative rms per measured period, and against the mean of the periods."""
    drive = data.voltage_V[:, :, realisation].mean(axis=2)
    moved = data.displacement_m[:, :, realisation]
    moved = moved - moved.mean(axis=0)
    left = moved - model.simulate(drive, periodic=True)[:, :, None]
    mean = np.sum(left.mean(axis=2) ** 2) / np.sum(moved.mean(axis=2) ** 2)
    return float(np.sqrt(np.sum(left**2) / np.sum(moved**2))), float(np.sqrt(mean))


def noise(data: piezoid.PeriodicData, realisation: int) -> float:
    """Return the relative rms of a period about the mean of its realisation, from differences."""
    moved = data.displacement_m[:, :, realisation]
    apart = moved[..., 0] - moved[..., 1]
    return float(np.sqrt(0.5 * np.sum(apart**2) / np.sum(moved.mean(axis=2) ** 2)))


def linear_response(data: piezoid.PeriodicData, left_out: int) -> float:
    """Return the relative rms of a response measured line by line, on the realisation left out."""
    lines = data.excited_lines()
    kept = [r for r in range(data.voltage_V.shape[2]) if r != left_out]
    measured = estimate_response(data.select(kept), lines=lines)
    return relative_rms(measured.response, measured.frequency_Hz, data.select([left_out]))


def without_terms(model: piezoid.CoupledStage) -> piezoid.CoupledStage:
    """Return the model with the linear part alone."""
    return replace(
        model,
        term_V=np.zeros_like(model.term_V),
        linear_V=np.zeros_like(model.linear_V),
        distortion_m=None,
    )


def gain_change(model: piezoid.CoupledStage) -> np.ndarray:
    """Return the relative change of the gain from the smallest to the largest level."""
    low, high = (model.response(GAIN_HZ, float(a)) for a in model.levels_V)
    return np.linalg.norm(high, axis=(1, 2)) / np.linalg.norm(low, axis=(1, 2)) - 1.0


def report(folder: Path) -> Iterator[str]:
    """Return the table, line by line."""
    levels = [read(folder, level) for level in LEVELS]
    count = levels[0].voltage_V.shape[2]
    began = time.perf_counter()
    whole = piezoid.fit_coupled(levels, modes=PAIRS, intervals=False)
    trained = time.perf_counter() - began
    yield "Steering mirror: relative rms in percent, each realisation left out once"
    yield f"{'left out':>10}" + "".join(
        f"{f'{level} period / mean (noise)':>34}" for level in LEVELS
    )
    models, table = [], []
    for r in range(count):
        kept = [k for k in range(count) if k != r]
        model = piezoid.fit_coupled(
            [one.select(kept) for one in levels], modes=PAIRS, intervals=False
        )
        models.append(model)
        row = [(*errors(model, one, r), noise(one, r)) for one in levels]
        table.append(row)
        cells = (f"{100 * p:.2f} / {100 * m:.2f} ({100 * n:.2f})" for p, m, n in row)
        yield f"{r + 1:>10}" + "".join(f"{cell:>34}" for cell in cells)
    found = 100 * np.array(table)
    rms, median = np.sqrt((found**2).mean(axis=0)), np.median(found, axis=0)
    yield from _rows(levels, models, rms, median, count)
    yield f"training, all realisations: {trained:.0f} s"
    yield from _changes(whole, models)


def _rows(
    levels: list[piezoid.PeriodicData],
    models: list[piezoid.CoupledStage],
    rms: np.ndarray,
    median: np.ndarray,
    count: int,
) -> Iterator[str]:
    rivals = np.array([[linear_response(one, r) for one in levels] for r in range(count)])
    bare = np.array(
        [[errors(without_terms(models[r]), one, r)[0] for one in levels] for r in range(count)]
    )
    rows = [
        ("piezoid, per period, rms of all", *(f"{v:.2f}" for v in rms[:, 0])),
        ("piezoid, per period, median", *(f"{v:.2f}" for v in median[:, 0])),
        ("piezoid, against the mean, rms", *(f"{v:.2f}" for v in rms[:, 1])),
        ("  its linear part alone, rms", *(f"{100 * v:.2f}" for v in _rms(bare))),
        ("linear response, line by line", *(f"{100 * v:.2f}" for v in _rms(rivals))),
        ("noise of a period, rms", *(f"{v:.2f}" for v in rms[:, 2])),
        *PUBLISHED,
    ]
    for name, low, high in rows:
        yield f"{name:<46}{low:>8}{high:>8}"


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


def _changes(whole: piezoid.CoupledStage, models: list[piezoid.CoupledStage]) -> Iterator[str]:
    """Tell what changes with the level; intervals by the jackknife over realisations."""
    low, high = (float(a) for a in whole.levels_V)
    jackknifed = replace(
        whole,
        replicate_frequency=np.stack([_matched(whole, model) for model in models]),
    )
    yield f"modes at {low:.3f} and {high:.3f} V rms, Hz; change in percent [95 %]; damping"
    for at_low, at_high, change, zl, zh in zip(
        whole.mode_frequency_Hz(low),
        whole.mode_frequency_Hz(high),
        100 * jackknifed.frequency_change(),
        whole.mode_damping(low),
        whole.mode_damping(high),
        strict=True,
    ):
        yield (
            f"{at_low:9.1f}{at_high:9.1f}   {change[0]:6.2f} [{change[1]:6.2f}, {change[2]:6.2f}]"
            f"   {zl:.4f} {zh:.4f}"
        )
    gains = np.stack([gain_change(model) for model in models])
    half = STUDENT_95 * np.sqrt(
        (len(gains) - 1) / len(gains) * ((gains - gains.mean(axis=0)) ** 2).sum(axis=0)
    )
    for f, value, width in zip(GAIN_HZ, gain_change(whole), half, strict=True):
        yield f"gain at {f:.0f} Hz: {100 * value:+.2f} % [+-{100 * width:.2f}] from low to high"


def _matched(whole: piezoid.CoupledStage, model: piezoid.CoupledStage) -> np.ndarray:
    """Return the frequencies of the modes of another fit nearest to those of the whole one."""
    near = np.abs(whole.log_frequency[0][:, None] - model.log_frequency[0]).argmin(axis=1)
    return model.log_frequency[:, near]
