"""A small stage of known plays and noise, fitted once for all tests of this folder."""

from functools import cache

import numpy as np

import piezoid
from piezoid.numerics.arrays import Array
from tests.identification.hysteresis.stages import RATE_Hz, decaying, play_sum, wandering

THRESHOLD_V = np.array([0.0, 0.7, 1.5, 2.6, 3.9])
WEIGHT_m_per_V = np.array([2.0, 0.5, 0.3, 0.2, 0.2]) * 1e-6
NOISE_m = 3e-9


def truth(drive_V: Array, before_V: float = 0.0, zero_m: float = 0.0) -> Array:
    """Return the displacement without noise after an extreme of ``before_V`` from rest."""
    memory_V = np.clip(np.zeros(5), before_V - THRESHOLD_V, before_V + THRESHOLD_V)
    return zero_m + play_sum(drive_V, THRESHOLD_V, WEIGHT_m_per_V, memory_V)


def recorded(
    drive_V: Array, seed: int, name: str, before_V: float = 0.0, zero_m: float = 0.0
) -> piezoid.Recording:
    noise_m = NOISE_m * np.random.default_rng(seed).standard_normal(len(drive_V))
    return piezoid.from_arrays(
        sampling_rate_Hz=RATE_Hz,
        voltage_V=drive_V,
        displacement_m=truth(drive_V, before_V, zero_m) + noise_m,
        name=name,
    )


def unseen_drive() -> Array:
    return wandering(np.random.default_rng(77), count=18)


@cache
def fitted() -> tuple[piezoid.Recording, piezoid.ActuatorModel]:
    sweep = recorded(decaying(per_unit=20), 1, "sweep")
    return sweep, piezoid.fit(sweep)
