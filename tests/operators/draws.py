"""Random models and memories for the property tests of this folder."""

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones, from_slopes
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.play import project_memory
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii


def draw_plays(rng: np.random.Generator) -> PrandtlIshlinskii:
    """Half of the draws have negative weights, all an increasing loading curve."""
    count = int(rng.integers(2, 12))
    threshold = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 1.0, count))])
    if rng.random() < 0.5:
        slope = rng.uniform(0.2, 2.0, count + 1)
        return PrandtlIshlinskii(threshold=threshold, weight=np.diff(slope, prepend=0.0))
    return PrandtlIshlinskii(threshold=threshold, weight=rng.uniform(0.05, 1.0, count + 1))


def draw_zones(rng: np.random.Generator) -> DeadZones:
    below, above = int(rng.integers(0, 5)), int(rng.integers(0, 5))
    up = np.cumsum(rng.uniform(0.2, 2.0, above))
    down = -np.cumsum(rng.uniform(0.2, 2.0, below))[::-1]
    slope = rng.uniform(0.3, 3.0, below + above + 2)
    slope[below + 1] = slope[below] = 1.0
    return from_slopes(np.concatenate([down, [0.0], up]), slope)


def draw_model(rng: np.random.Generator) -> ModifiedPrandtlIshlinskii:
    return ModifiedPrandtlIshlinskii(
        plays=draw_plays(rng),
        dead_zones=draw_zones(rng),
        voltage_offset_V=float(rng.normal()),
        displacement_offset_m=float(rng.normal()),
        envelope=LINEAR if rng.random() < 0.5 else draw_zones(rng),
    )


def draw_memory(rng: np.random.Generator, model: ModifiedPrandtlIshlinskii) -> Array:
    """An admissible memory, reached by clamping an arbitrary one."""
    threshold = model.plays.threshold
    return project_memory(rng.normal(0, 2, len(threshold)), float(rng.normal()), threshold)


def random_walk(rng: np.random.Generator, samples: int, step: float = 0.5) -> Array:
    return np.asarray(np.cumsum(rng.normal(0, step, samples)) * 0.3)
