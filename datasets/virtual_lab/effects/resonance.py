"""Resonance: the stage is a mass on a spring and rings after fast drives.

    m'' + 2 z w m' + w^2 m = w^2 h,      x = (1 - p) h + p m

with w = 2 pi f and a damping z of some per cent. Either the complete displacement passes through
the main mode (p = 1; its frequency determines the size), or a side mode of the flexures at a
lower frequency contributes a fraction p.

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
    Scene,
    Trace,
)
from piezoid_datasets.virtual_lab.effects.sizing import bisected, proportional
from piezoid_datasets.virtual_lab.signals import Array, second_order

MAIN_MODES_Hz = (120.0, 6000.0)
SIDE_MODES_Hz = (150.0, 600.0)


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the damping and the type of mode; search for its frequency or its fraction."""
    damping = float(rng.uniform(0.01, 0.06))
    frequency_Hz = float(np.exp(rng.uniform(*np.log(SIDE_MODES_Hz))))
    unit = [_swing(trace, 1.0 / frequency_Hz, damping) for trace in bench.traces]
    share = proportional(size_m, EFFECT.measure, unit, why="the stage does not move")
    if share > 1.0 or rng.random() < 0.5:
        share = 1.0
        frequency_Hz = 1.0 / bisected(
            size_m,
            EFFECT.measure,
            bench.traces,
            lambda trace, softness_s: _swing(trace, softness_s, damping),
            (1.0 / MAIN_MODES_Hz[1], 1.0 / MAIN_MODES_Hz[0]),
        )

    def ring(stage_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        mode_m = second_order(stage_m, frequency_Hz, damping, scene.rate_Hz)
        return stage_m + share * (mode_m - stage_m)

    return Fault(
        acts=(Act(name=EFFECT.name, place=Place.MECHANICS, change=ring),),
        numbers={"frequency_Hz": frequency_Hz, "damping": damping, "share": share},
    )


def _swing(trace: Trace, softness_s: float, damping: float) -> Array:
    """Return the change of the displacement by a mode at the frequency ``1 / softness_s``."""
    quiet_m = trace.displacement_m
    return second_order(quiet_m, 1.0 / softness_s, damping, trace.scene.rate_Hz) - quiet_m


EFFECT = Effect(
    name="resonance",
    measure=Measure.RMS,
    visible_percent=0.15,
    shown_by=("chirp",),
    install=install,
)
