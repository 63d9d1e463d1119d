"""Gain change: at one instant the sensitivity of the stage changes permanently.

A load is added, a connector moves, or a heater switches: the displacement is multiplied by
``1 + d`` from an instant in one recording on, including all later recordings.

Source: spring load on a ceramic of finite stiffness, as in manufacturers' application notes.
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

SETTLING_s = 2e-3


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the instant and the sign; scale to the size at the largest displacement after it."""
    order = int(rng.integers(len(bench.traces)))
    instant_s = float(rng.uniform(0.3, 0.7)) * float(bench.traces[order].scene.time_s[-1])
    sign = float(rng.choice([-1.0, 1.0]))

    def changed(scene: Scene) -> Array:
        if scene.order != order:
            return np.full_like(scene.time_s, float(scene.order > order))
        return -np.expm1(-np.maximum(scene.time_s - instant_s, 0.0) / SETTLING_s)

    farthest_m = max(
        float(np.max(np.abs(trace.displacement_m * changed(trace.scene))))
        for trace in bench.traces
    )
    gain = sign * size_m / farthest_m
    act = Act(
        name=EFFECT.name,
        place=Place.MECHANICS,
        change=lambda stage_m, scene, _: stage_m * (1.0 + gain * changed(scene)),
    )
    return Fault(
        acts=(act,),
        numbers={"relative_change": gain, "recording": float(order), "instant_s": instant_s},
    )


EFFECT = Effect(
    name="gain_change",
    measure=Measure.PEAK,
    visible_percent=0.8,
    shown_by=("sweep",),
    install=install,
)
