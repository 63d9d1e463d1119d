"""Effects outside the catalogue of the diagnosis.

Each is one change in the chain. They test whether a diagnosis reports an unexplained residual, and
along which coordinate it is systematic.
"""

from collections.abc import Callable

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import Fault, Place, Scene
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array

AWAY_Hz = 4.0  # minimum distance from every harmonic of the mains


def tone(size_m: float, _: Rig, rng: np.random.Generator) -> Fault:
    """A pump, fan or chopper: a line at a fixed frequency away from the mains harmonics; rms."""
    candidates_Hz = np.exp(rng.uniform(np.log(12.0), np.log(180.0), 50)).tolist()
    lines_Hz = np.array([k * grid for k in range(1, 8) for grid in (50.0, 60.0)])
    frequency_Hz = next(f for f in candidates_Hz if np.min(np.abs(lines_Hz - f)) > AWAY_Hz)

    def change(reading_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        wave = np.sin(2.0 * np.pi * frequency_Hz * scene.time_s + 1.7 * scene.order)
        return np.asarray(reading_m + np.sqrt(2.0) * size_m * wave)

    return Fault(Place.SENSOR, change, {})


def range_end(size_m: float, rig: Rig, _: np.random.Generator) -> Fault:
    """A sensor range shorter than the stroke; peak."""
    end_m = rig.stroke_m - size_m
    return Fault(Place.SENSOR, lambda reading_m, _scene, _: np.minimum(reading_m, end_m), {})


def dent(size_m: float, rig: Rig, rng: np.random.Generator) -> Fault:
    """A scratch on the scale: an error near one position; peak."""
    middle_m, width_m = float(rng.uniform(0.3, 0.7)) * rig.stroke_m, 0.03 * rig.stroke_m

    def change(reading_m: Array, _: Scene, __: np.random.Generator) -> Array:
        return reading_m + size_m * np.exp(-0.5 * ((reading_m - middle_m) / width_m) ** 2)

    return Fault(Place.SENSOR, change, {})


def every_nth(size_m: float, _: Rig, rng: np.random.Generator) -> Fault:
    """A converter with a shared reference: an error in every n-th reading; peak."""
    period = int(rng.integers(3, 40))

    def change(reading_m: Array, _: Scene, __: np.random.Generator) -> Array:
        out = reading_m.copy()
        out[::period] += size_m
        return out

    return Fault(Place.CONVERTER, change, {})


# (size_m, rig, rng) -> Fault; the docstring says whether the size is rms or peak
UNCATALOGUED: dict[str, Callable[[float, Rig, np.random.Generator], Fault]] = {
    function.__name__: function for function in (tone, range_end, dent, every_nth)
}
