"""Random drives for the tests of this folder."""

import numpy as np

from piezoid.numerics.arrays import Array


def random_walk(rng: np.random.Generator, samples: int, step: float = 0.5) -> Array:
    return np.asarray(np.cumsum(rng.normal(0, step, samples)) * 0.3)
