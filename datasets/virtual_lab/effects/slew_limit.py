"""Slew limit: the current of the amplifier limits the rate at which it charges the ceramic.

    |dV/dt| <= I / C

at the output. Below the limit the output is correct; above it the output is a straight line that
is late and, if the command turns too soon, does not reach the command.

Source: Fleming & Moheimani, control of piezoelectric tube scanners; amplifier data sheets.
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
from piezoid_datasets.virtual_lab.signals import Array

FINE_ENOUGH_Hz = 20e3  # sufficient for the scaling


def install(size_m: float, bench: Bench, _: np.random.Generator) -> Fault:
    """Search for the limit, with the mean gain of the stage over its range."""
    rig = bench.rig
    range_V = rig.amplifier_gain_V_per_V * (rig.drive_max_V - rig.drive_min_V)

    def change(trace: Trace, slowness_s_per_V: float) -> Array:
        kept = max(round(trace.scene.rate_Hz / FINE_ENOUGH_Hz), 1)
        asked_V = trace.amplifier_V[::kept]
        step_V = kept / (slowness_s_per_V * trace.scene.rate_Hz)
        return rig.stroke_m / range_V * (limited(asked_V, step_V) - asked_V)

    fastest = max(_fastest(trace) for trace in bench.traces)
    slowness = bisected(
        size_m, EFFECT.measure, bench.traces, change, (1.0 / fastest, 1e3 / fastest)
    )
    act = Act(
        name=EFFECT.name,
        place=Place.OUTPUT,
        change=lambda asked_V, scene, _: limited(asked_V, 1.0 / (slowness * scene.rate_Hz)),
    )
    return Fault(acts=(act,), numbers={"slew_V_per_s": 1.0 / slowness})


def limited(asked_V: Array, step_V: float) -> Array:
    """Return a voltage that follows the command by at most one step per sample."""
    if np.max(np.abs(np.diff(asked_V)), initial=0.0) <= step_V:
        return asked_V
    output_V = float(asked_V[0])
    followed = np.empty_like(asked_V)
    for k, target_V in enumerate(asked_V.tolist()):
        output_V += min(max(target_V - output_V, -step_V), step_V)
        followed[k] = output_V
    return followed


def _fastest(trace: Trace) -> float:
    return float(np.max(np.abs(np.diff(trace.amplifier_V)))) * trace.scene.rate_Hz


EFFECT = Effect(
    name="slew_limit",
    measure=Measure.RMS,
    visible_percent=0.3,
    shown_by=("rates",),
    install=install,
)
