"""Lag: an undeclared filter in the sensor.

    tau dy/dt = x - y

Examples are an output filter with a lower corner, a servo that limits the bandwidth, or a
demodulator. At low frequencies it is a delay of tau; at higher frequencies it also attenuates.

Source: capacitive sensor manuals: the bandwidth switch.
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
from piezoid_datasets.virtual_lab.signals import Array, first_order

TIME_CONSTANTS_s = (1e-6, 0.1)


def install(size_m: float, bench: Bench, _: np.random.Generator) -> Fault:
    """Search for the time constant that gives the size."""

    def change(trace: Trace, tau_s: float) -> Array:
        return filtered(trace.displacement_m, tau_s, trace.scene.rate_Hz) - trace.displacement_m

    tau_s = bisected(size_m, EFFECT.measure, bench.traces, change, TIME_CONSTANTS_s)
    return Fault(
        acts=(
            Act(
                name=EFFECT.name,
                place=Place.SENSOR,
                change=lambda reading_m, scene, _: filtered(reading_m, tau_s, scene.rate_Hz),
            ),
        ),
        numbers={"time_constant_s": tau_s},
    )


def filtered(reading_m: Array, tau_s: float, rate_Hz: float) -> Array:
    """Return the output of the filter, which starts in the steady state."""
    return first_order(reading_m, tau_s, rate_Hz, float(reading_m[0]))


EFFECT = Effect(
    name="lag",
    measure=Measure.RMS,
    visible_percent=0.25,
    shown_by=("rates", "chirp"),
    install=install,
)
