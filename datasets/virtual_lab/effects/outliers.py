"""Outliers: single readings disturbed by a spark, a bit error, or a switching relay.

Rare, of either sign, one row long.

Source: Hampel's contamination model: a small share of samples from another distribution.
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
from piezoid_datasets.virtual_lab.signals import Array

SHARES = (2e-4, 1e-3)
AT_LEAST = 4


def install(size_m: float, _: Bench, rng: np.random.Generator) -> Fault:
    """Draw the outliers, between half the size and the size; the largest has the size."""
    share = float(np.exp(rng.uniform(*np.log(SHARES))))

    def spike(sampled_m: Array, _: Scene, chance: np.random.Generator) -> Array:
        count = max(round(share * len(sampled_m)), AT_LEAST)
        rows = chance.choice(len(sampled_m), size=count, replace=False)
        height_m = size_m * np.linspace(0.5, 1.0, count) * chance.choice([-1.0, 1.0], count)
        hit = sampled_m.copy()
        hit[rows] += height_m
        return hit

    act = Act(name=EFFECT.name, place=Place.RECORD, change=spike)
    return Fault(acts=(act,), numbers={"share_of_rows": share, "largest_m": size_m})


EFFECT = Effect(
    name="outliers",
    measure=Measure.PEAK,
    visible_percent=0.8,
    shown_by=("sweep",),
    install=install,
)
