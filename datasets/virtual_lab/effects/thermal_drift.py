"""Thermal drift: expansion of the frame, independent of the drive.

Three heat sources move the stage relative to its sensor: the electronics during warm-up (one
exponential), the time of day (a straight line), and the air conditioning (a slow sine):

    d(t) = a (1 - exp(-t / tau)) + b t + c sin(2 pi t / P + phi)

Time continues through the campaign; the sensor is zeroed before each recording.

Source: Kuhnen, Eur. J. Control 9 (2003) on what remains after hysteresis and creep are removed;
heat conduction as in any laboratory.
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
from piezoid_datasets.virtual_lab.effects.sizing import proportional
from piezoid_datasets.virtual_lab.signals import Array

BETWEEN_RECORDINGS_s = 120.0


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the three sources and scale them together."""
    warm_up_s = float(np.exp(rng.uniform(np.log(30.0), np.log(900.0))))
    period_s = float(rng.uniform(300.0, 1200.0))
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    shares = rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)

    def drift(scene: Scene) -> Array:
        start_s = scene.order * BETWEEN_RECORDINGS_s
        time_s = np.concatenate(([0.0], scene.time_s)) + start_s
        expansion = (
            shares[0] * -np.expm1(-time_s / warm_up_s)
            + shares[1] * time_s / warm_up_s
            + shares[2] * np.sin(2.0 * np.pi * time_s / period_s + phase)
        )
        return np.asarray(expansion[1:] - expansion[0])

    scale_m = proportional(
        size_m,
        EFFECT.measure,
        [drift(trace.scene) for trace in bench.traces],
        why="no time passes",
    )
    return Fault(
        acts=(
            Act(
                name=EFFECT.name,
                place=Place.MECHANICS,
                change=lambda stage_m, scene, _: stage_m + scale_m * drift(scene),
            ),
        ),
        numbers={
            "warm_up_m": scale_m * float(shares[0]),
            "warm_up_s": warm_up_s,
            "ramp_m_per_s": scale_m * float(shares[1]) / warm_up_s,
            "cycle_m": scale_m * float(shares[2]),
            "cycle_s": period_s,
        },
    )


EFFECT = Effect(
    name="thermal_drift",
    measure=Measure.RMS,
    visible_percent=0.2,
    shown_by=("long_hold", "staircase"),
    install=install,
)
