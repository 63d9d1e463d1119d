"""Paths of a field, and the strain of a ceramic of the virtual laboratory."""

import itertools

import numpy as np
from numpy.typing import NDArray

from piezoid_datasets.virtual_lab.truths.truth import Ceramic

Array = NDArray[np.float64]
EXACT = 1e-11  # of the stroke: rounding of the field to 13 decimals, times slopes of order one
CYCLED = np.array([1.0, -1.0])


def walk(*turns: float, points: int = 60) -> Array:
    legs = [np.linspace(a, b, points) for a, b in itertools.pairwise(turns)]
    return np.concatenate(legs)


def strain(ceramic: Ceramic, field: Array, history: Array = CYCLED) -> Array:
    reversible, irreversible = ceramic.respond(field, history)
    return reversible + irreversible
