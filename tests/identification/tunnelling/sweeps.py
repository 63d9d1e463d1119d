"""Simulated sweeps with known truth, and sweeps of the recorded file."""

from pathlib import Path

import numpy as np

from piezoid.identification.tunnelling.approach import ApproachCurve, Direction, read_approach
from piezoid.numerics.arrays import Array
from piezoid.records.readers import read_table
from piezoid.records.table import RawTable

DECAY_PER_M = 20.5e9
HEIGHT_M = np.linspace(-0.21e-9, 0.49e-9, 200)
OFFSET_A = -0.04e-12


def correlated(rng: np.random.Generator, samples: int, correlation: float) -> Array:
    """Unit-variance noise whose neighbours are correlated."""
    noise = rng.standard_normal(samples)
    for n in range(1, samples):
        noise[n] = correlation * noise[n - 1] + np.sqrt(1.0 - correlation**2) * noise[n]
    return noise


def sweep(
    rng: np.random.Generator,
    *,
    decay_per_m: float = DECAY_PER_M,
    peak_A: float = 750e-12,
    floor_A: float = 0.015e-12,
    relative: float = 0.01,
    correlation: float = 0.0,
    jump_nepers: float = 0.0,
    polarity: float = -1.0,
    direction: Direction = Direction.FORWARD,
    shift_m: float = 0.0,
) -> ApproachCurve:
    """A sweep like the real one; the jump lies at height zero, away from the surface."""
    above_m = HEIGHT_M - HEIGHT_M[0] - shift_m
    tunnelling_A = peak_A * np.exp(-decay_per_m * above_m + jump_nepers * (HEIGHT_M > 0.0))
    jitter = np.exp(relative * correlated(rng, len(HEIGHT_M), correlation))
    dark_A = OFFSET_A + floor_A * rng.standard_normal(len(HEIGHT_M))
    return read_approach(
        HEIGHT_M,
        polarity * tunnelling_A * jitter + dark_A,
        bias_V=polarity * 0.02,
        direction=direction,
        label="simulated",
    )


def real_table(realdata: Path) -> RawTable:
    """Return the recorded Z spectroscopy."""
    return read_table(realdata / "stm_current_vs_z" / "z.dat")


def real_sweep(table: RawTable, number: str, direction: Direction) -> ApproachCurve:
    """Return one sweep of the recorded file: number "AVG", "00001", ..."""
    suffix = " [bwd]" if direction is Direction.BACKWARD else ""
    return read_approach(
        table.si("Z rel (m)"),
        table.si(f"Current [{number}]{suffix} (A)"),
        bias_V=float(table.si(f"Bias [{number}]{suffix} (V)")[0]),
        direction=direction,
        label=f"Current [{number}]{suffix}",
    )


def changed(
    curve: ApproachCurve, current_A: Array | None = None, *, height_sign: float = 1.0
) -> ApproachCurve:
    """Return the sweep with another current, or with an inverted height."""
    return read_approach(
        height_sign * curve.height_m,
        curve.current_A if current_A is None else current_A,
        bias_V=curve.bias_V,
        direction=curve.direction,
        label="changed",
    )
