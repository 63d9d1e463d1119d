"""Resonance: the stage is a mass on a spring and rings when it is pushed fast.

    x'' + 2 z w x' + w^2 x = w^2 h,      w = 2 pi f,  damping z of some per cent

The whole displacement passes through the mode; its frequency decides how much one sees.

Source: any flexure stage's data sheet; Devasia, Eleftheriou & Moheimani, IEEE TCST 15 (2007).
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
    Trace,
)
from piezoid_datasets.virtual_lab.effects.sizing import bisected
from piezoid_datasets.virtual_lab.signals import Array, second_order

FREQUENCIES_Hz = (120.0, 6000.0)


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the damping and search the frequency."""
    damping = float(rng.uniform(0.01, 0.06))

    def change(trace: Trace, softness_s: float) -> Array:
        still = trace.displacement_m
        return second_order(still, 1.0 / softness_s, damping, trace.scene.rate_Hz) - still

    softest, stiffest = FREQUENCIES_Hz
    frequency_Hz = 1.0 / bisected(
        size_m, EFFECT.measure, bench.traces, change, (1.0 / stiffest, 1.0 / softest)
    )
    return Fault(
        acts=(
            Act(
                name=EFFECT.name,
                place=Place.MECHANICS,
                change=lambda stage_m, scene, _: second_order(
                    stage_m, frequency_Hz, damping, scene.rate_Hz
                ),
            ),
        ),
        numbers={"frequency_Hz": frequency_Hz, "damping": damping},
    )


EFFECT = Effect(
    name="resonance",
    measure=Measure.RMS,
    visible_percent=0.15,
    shown_by=("chirp",),
    install=install,
)
