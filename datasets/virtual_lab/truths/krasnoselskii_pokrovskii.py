"""A Krasnosel'skii-Pokrovskii ceramic: a sum of relays whose sides are slopes.

    k = max(k, r(E - up))  rising,      k = min(k, r(E - down))  falling,      down <= up

The ridge r climbs smoothly from -1 to 1 over some width, so a finite sum of kernels (one for each
pair of thresholds on a grid) is continuous. Weights are a bell over the triangle of pairs. Wiping-
out and congruency hold as for Preisach's relays; loops of equal span differ with bias.

Source: Krasnosel'skii & Pokrovskii, Systems with Hysteresis (1989); Banks, Kurdila & Webb, Math.
Probl. Eng. 3 (1997) 287; for piezo stages Galinaitis, thesis, Virginia Tech (1999).
"""

from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.truths.branches import branches, settled
from piezoid_datasets.virtual_lab.truths.truth import (
    Ceramic,
    Truth,
    ceramic_with_opening,
    gentle_curve,
)

THRESHOLDS = np.linspace(-1.7, 1.3, 16)
RIDGE = 0.8  # four steps of the grid: no step of it can be seen in a branch
DOWN, UP = (np.array(side) for side in np.triu_indices(len(THRESHOLDS)))
AT_ONCE = 4096  # samples, so that a long branch stays within a few megabytes


@dataclass(frozen=True, kw_only=True, eq=False)
class Kernels:
    """Weights of the kernels (pairs,)."""

    weight: Array

    def output(self, kernels: Array) -> Array:
        """Return the weighted sum of kernels (..., pairs)."""
        return kernels @ self.weight


def ridge(field: Array) -> Array:
    """Return r, between -1 and 1, of fields before or behind a threshold."""
    climb = np.clip(field / RIDGE, 0.0, 1.0)
    return np.asarray(2.0 * climb**2 * (3.0 - 2.0 * climb) - 1.0)


def krasnoselskii_pokrovskii_memory(law: Kernels, path: Array) -> Array:
    """Return the sum of the kernels along a path that starts with all of them down."""
    path = settled(path)
    state = np.full(len(DOWN), -1.0)
    output = np.full(len(path), float(law.output(state)))
    for start, end, rising in branches(path):
        for first in range(start, end, AT_ONCE):
            piece = slice(first + 1, min(first + AT_ONCE, end) + 1)
            side = ridge(path[piece, None] - THRESHOLDS)
            kernels = (
                np.maximum(state, side[:, UP]) if rising else np.minimum(state, side[:, DOWN])
            )
            output[piece] = law.output(kernels)
            state = kernels[-1]
    return output


def draw_krasnoselskii_pokrovskii(rng: np.random.Generator) -> Ceramic:
    """Draw a bell of weights, off the middle and wider along the diagonal than across it."""
    middle, half = 0.5 * (THRESHOLDS[UP] + THRESHOLDS[DOWN]), THRESHOLDS[UP] - THRESHOLDS[DOWN]
    along = (middle + 0.5 * RIDGE - rng.uniform(-0.3, 0.3)) / rng.uniform(0.5, 0.9)
    across = half / rng.uniform(0.5, 0.9)
    law = Kernels(weight=np.exp(-0.5 * along**2 - across) * rng.uniform(0.7, 1.3, len(DOWN)))
    reversible = gentle_curve(rng)
    return ceramic_with_opening(
        float(rng.uniform(0.08, 0.14)),
        reversible,
        lambda path: krasnoselskii_pokrovskii_memory(law, path),
    )


TRUTH = Truth(name="krasnoselskii_pokrovskii", draw=draw_krasnoselskii_pokrovskii)
