"""Amplifier saturation: the command exceeds the range of the supply.

    V = min(max(V, V_low), V_high)

at the output of the amplifier, on one side or on both. The memory of the ceramic then follows the
clipped voltage and not the command.

Source: data sheets of high-voltage amplifiers.
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
from piezoid_datasets.virtual_lab.signals import Array

SIDES = (("high",), ("low",), ("high", "low"))


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw the sides, and set each limit such that the displacement is short by the size."""
    sides = SIDES[int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    output_V = np.concatenate([trace.amplifier_V for trace in bench.traces])
    moved_m = np.concatenate([trace.displacement_m for trace in bench.traces])
    limits = {"low": -np.inf, "high": np.inf}
    for side in sides:
        limits[side] = _limit(side, size_m, output_V, moved_m)
    act = Act(
        name=EFFECT.name,
        place=Place.OUTPUT,
        change=lambda asked_V, _scene, _: np.clip(asked_V, limits["low"], limits["high"]),
    )
    return Fault(acts=(act,), numbers={f"{side}_V": limits[side] for side in sides})


def _limit(side: str, size_m: float, output_V: Array, moved_m: Array) -> float:
    """Return the voltage at which the displacement differs from its extreme by the size."""
    if side == "high":
        return float(np.max(output_V[moved_m <= np.max(moved_m) - size_m], initial=-np.inf))
    return float(np.min(output_V[moved_m >= np.min(moved_m) + size_m], initial=np.inf))


EFFECT = Effect(
    name="amplifier_saturation",
    measure=Measure.PEAK,
    visible_percent=1.2,
    shown_by=("sweep",),
    install=install,
)
