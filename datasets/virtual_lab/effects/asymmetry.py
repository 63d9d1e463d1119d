"""Asymmetry: strain is proportional to the square of the polarisation of a poled ceramic.

Around the remanent polarisation the square has a slope, which is the piezoelectric effect, and
a curvature, which bends rising and falling branches to the same side:

    s + 4 a s (1 - s),      s from 0 to 1 over the stroke

The ends of the stroke are unchanged.

Source: electrostriction, s = Q P^2; Damjanovic, Rep. Prog. Phys. 61 (1998).
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
)
from piezoid_datasets.virtual_lab.effects.sizing import proportional
from piezoid_datasets.virtual_lab.signals import Array


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the sign of the curvature, and scale it to the size."""
    stroke_m = bench.rig.stroke_m

    def bent(ceramic_m: Array) -> Array:
        return 4.0 * ceramic_m * (1.0 - ceramic_m / stroke_m)

    unit = [bent(trace.displacement_m) for trace in bench.traces]
    size_m *= float(rng.choice([-1.0, 1.0]))
    curvature = proportional(size_m, EFFECT.measure, unit, why="the stage does not move")
    act = Act(
        name=EFFECT.name,
        place=Place.CERAMIC,
        change=lambda ceramic_m, _scene, _: ceramic_m + curvature * bent(ceramic_m),
    )
    return Fault(acts=(act,), numbers={"curvature": curvature})


EFFECT = Effect(
    name="asymmetry",
    measure=Measure.RMS,
    visible_percent=0.6,
    shown_by=("sweep",),
    install=install,
)
