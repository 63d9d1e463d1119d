"""Mains interference: hum in the sensor cable.

A line at 50 or 60 Hz with harmonics, whose frequency varies by some hundredths of a hertz with the
load of the grid, so that its phase drifts relative to any fixed sine:

    m(t) = sum_k a_k sin(k theta(t) + phi_k),     dtheta/dt = 2 pi (f + wander)

Source: grid frequency statistics as published by ENTSO-E (standard deviation about 20 mHz).
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
    Scene,
)
from piezoid_datasets.virtual_lab.signals import Array, coloured_noise

HARMONICS = np.array([1.0, 2.0, 3.0, 5.0])
WANDER_Hz = 0.02
WANDER_CORNER_Hz = 0.05


def install(size_m: float, _: Bench, rng: np.random.Generator) -> Fault:
    """Draw the mains frequency, the harmonics and their phases."""
    grid_Hz = float(rng.choice([50.0, 60.0]))
    strength = np.array([1.0, 0.15, 0.35, 0.2]) * rng.uniform(0.3, 1.0, 4)
    strength[0] = 1.0
    strength *= np.sqrt(2.0) * size_m / np.sqrt(np.sum(strength**2))
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)

    def hum(reading_m: Array, scene: Scene, chance: np.random.Generator) -> Array:
        wander = coloured_noise(len(reading_m), scene.rate_Hz, WANDER_CORNER_Hz, 0.0, chance)
        turns = np.cumsum(grid_Hz + WANDER_Hz * wander) / scene.rate_Hz + chance.random()
        lines = zip(HARMONICS, strength, phases, strict=True)
        heard = reading_m.copy()
        for k, amplitude_m, phase in lines:
            heard += amplitude_m * np.sin(2.0 * np.pi * k * turns + phase)
        return heard

    numbers: dict[str, float | str] = {"grid_Hz": grid_Hz}
    numbers |= {f"amplitude_{k:.0f}_m": float(a) for k, a in zip(HARMONICS, strength, strict=True)}
    return Fault(acts=(Act(name=EFFECT.name, place=Place.SENSOR, change=hum),), numbers=numbers)


EFFECT = Effect(
    name="mains_interference",
    measure=Measure.RMS,
    visible_percent=0.1,
    shown_by=("rates", "chirp", "staircase"),
    install=install,
)
