"""Rate dependence: domain walls that respond with a delay.

The irreversible strain w approaches its quasi-static value q by thermally activated jumps over
barriers that the lag lowers:

    dw/dt = (s / tau) sinh((q - w) / s)

Slow drives lag like a filter with time constant tau, fast drives only by s asinh(rate tau / s),
which grows with the logarithm of the rate. The reversible part does not lag. Over a time h with
constant q, ``tanh(e / 2s)`` of the lag e decays by ``exp(-h / tau)``: this step is exact.

Source: Fulcher, Cole & Bishop kinetics of activated walls as in Smith, Smart Material Systems
(2005), chapter 2.
"""

import math

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
from piezoid_datasets.virtual_lab.signals import Array

TIME_CONSTANTS_s = (2e-5, 0.2)
FINE_ENOUGH_Hz = 20e3  # sufficient for the scaling


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the strain scale of the barriers and search for the time constant."""
    scale = float(rng.uniform(0.005, 0.03))

    def change(trace: Trace, tau_s: float) -> Array:
        kept = max(round(trace.scene.rate_Hz / FINE_ENOUGH_Hz), 1)
        still = trace.irreversible[::kept]
        moved = follow_slowly(still, tau_s, scale, trace.scene.rate_Hz / kept)
        return bench.rig.stroke_m * (moved - still)

    tau_s = bisected(size_m, EFFECT.measure, bench.traces, change, TIME_CONSTANTS_s)
    return Fault(
        acts=(
            Act(
                name=EFFECT.name,
                place=Place.IRREVERSIBLE,
                change=lambda still, scene, _: follow_slowly(still, tau_s, scale, scene.rate_Hz),
            ),
        ),
        numbers={"time_constant_s": tau_s, "barrier_strain": scale},
    )


def follow_slowly(still: Array, tau_s: float, scale: float, rate_Hz: float) -> Array:
    """Return the irreversible strain that lags behind its quasi-static value."""
    decay = math.exp(-1.0 / (tau_s * rate_Hz))
    moved = np.empty_like(still)
    wall = float(still[0])
    for k, target in enumerate(still.tolist()):
        lag = target - wall
        wall = target - 2.0 * scale * math.atanh(decay * math.tanh(lag / (2.0 * scale)))
        moved[k] = wall
    return moved


EFFECT = Effect(
    name="rate_dependence",
    measure=Measure.RMS,
    visible_percent=0.15,
    shown_by=("rates",),
    install=install,
)
