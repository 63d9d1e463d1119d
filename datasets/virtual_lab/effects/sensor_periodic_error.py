"""Sensor periodic error: an error of the reading that is periodic in the displacement.

If two beams of an interferometer mix, or the two phases of an encoder have unequal amplitudes, the
reading has an error that is periodic in the displacement:

    y = x + a sin(2 pi x / p + phi) + b sin(4 pi x / p + psi)

Source: Heydemann, Appl. Opt. 20 (1981); first and second order of the cyclic error.
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

PERIODS_m = (0.6e-6, 4e-6)


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the period and both phases, and scale the error."""
    period_m = float(np.exp(rng.uniform(*np.log(PERIODS_m))))
    second = float(rng.uniform(0.1, 0.4))
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)

    def error(displacement_m: Array) -> Array:
        turn = 2.0 * np.pi * displacement_m / period_m
        return np.asarray(np.sin(turn + phases[0]) + second * np.sin(2.0 * turn + phases[1]))

    unit = [error(trace.displacement_m) for trace in bench.traces]
    amplitude_m = proportional(size_m, EFFECT.measure, unit, why="no recording has a row")
    act = Act(
        name=EFFECT.name,
        place=Place.SENSOR,
        change=lambda reading_m, _scene, _: reading_m + amplitude_m * error(reading_m),
    )
    return Fault(
        acts=(act,),
        numbers={"period_m": period_m, "amplitude_m": amplitude_m, "second_order": second},
    )


EFFECT = Effect(
    name="sensor_periodic_error",
    measure=Measure.RMS,
    visible_percent=0.06,
    shown_by=("sweep",),
    install=install,
)
