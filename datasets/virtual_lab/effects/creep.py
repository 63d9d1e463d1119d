"""Creep: domains that continue to switch for hours after a change of the field.

Domain walls cross barriers of widely distributed heights, so the relaxation times are uniformly
distributed over the logarithm of time:

    x(t) = h(t) + integral g(tau) h_tau(t) d log10 tau,    tau dh_tau/dt = h - h_tau

with h the response of the domains that switch instantly. The spectrum g is flat over six decades
with soft ends. The integral is computed with eight relaxation times per decade, many more than a
fit would use.

Source: Jung & Gweon, Rev. Sci. Instrum. 71 (2000); spectrum after Vieira, IBM J. Res. Dev. 30
(1986).
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
from piezoid_datasets.virtual_lab.signals import Array, first_order

DECADES = (-2.0, 4.0)  # of relaxation time in seconds
PER_DECADE = 8
EDGE_DECADES = 0.5
CYCLED_s = 5.0  # duration of the cycles before the rest: slow domains hardly respond


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Scale the spectrum to the size of the additional displacement."""
    tilt = float(rng.uniform(-0.15, 0.15))
    unit = [_crept(trace.displacement_m, trace.scene, tilt) for trace in bench.traces]
    per_decade = proportional(size_m, EFFECT.measure, unit, why="the stage does not move")
    return creep_of(per_decade, tilt)


def creep_of(per_decade: float, tilt: float) -> Fault:
    """Return creep of a given strength, the fraction of a step per decade of time."""

    def change(ceramic_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        return ceramic_m + per_decade * _crept(ceramic_m, scene, tilt)

    return Fault(
        acts=(Act(name="creep", place=Place.CERAMIC, change=change),),
        numbers={"creep_per_decade": per_decade, "spectrum_tilt_per_decade": tilt},
    )


def _crept(response_m: Array, scene: Scene, tilt: float) -> Array:
    """Return the integral over a spectrum of one per decade."""
    first, last = DECADES
    decades = first + (np.arange(round((last - first) * PER_DECADE)) + 0.5) / PER_DECADE
    ends = np.minimum(decades - first, last - decades)
    weight = np.clip(ends / EDGE_DECADES, 0.0, 1.0) * (1.0 + tilt * (decades - 1.0)) / PER_DECADE
    middle_m = 0.5 * float(np.min(response_m) + np.max(response_m))
    crept = np.zeros_like(response_m)
    for log_tau, share in zip(decades, weight, strict=True):
        tau_s = 10.0 ** float(log_tau)
        left = -np.expm1(-CYCLED_s / tau_s) * np.exp(-scene.rest_s / tau_s)
        start = float(response_m[0] + (middle_m - response_m[0]) * left)
        crept += share * first_order(response_m, tau_s, scene.rate_Hz, start)
    return crept


EFFECT = Effect(
    name="creep",
    measure=Measure.RMS,
    visible_percent=0.5,
    shown_by=("staircase", "long_hold"),
    install=install,
)
