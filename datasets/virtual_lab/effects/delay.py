"""Delay: the reading is late by a time or by a number of rows.

    y(t) = x(t - tau)

A cable, a servo or a digital filter with its own clock delays by the same time in every
recording. A converter that returns its result some conversions later delays by rows, which is
another time in a recording of another rate.

Source: Devasia, Eleftheriou & Moheimani, IEEE TCST 15 (2007).
"""

from collections.abc import Callable

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
from piezoid_datasets.virtual_lab.effects.sizing import bisected
from piezoid_datasets.virtual_lab.signals import Array, shifted

DelayIn = Callable[[Scene], float]

DELAYS_s = (1e-6, 0.1)
ROWS = (0.05, 200.0)
MISFIT = 0.25  # largest relative deviation from the size for an integer number of rows


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Delay by rows if drawn and if an integer number gives the size, otherwise by a time."""
    rows = bisected(size_m, EFFECT.measure, bench.traces, _change_by_rows, ROWS)
    whole = max(round(rows), 1)
    if rng.random() < 0.5 and abs(whole / rows - 1.0) < MISFIT:
        return _fault_of(lambda scene: whole / scene.record_rate_Hz, "rows", float(whole))
    delay_s = bisected(size_m, EFFECT.measure, bench.traces, _change, DELAYS_s)
    return _fault_of(lambda _: delay_s, "delay_s", delay_s)


def _fault_of(delay_s_in: DelayIn, key: str, number: float) -> Fault:
    def change(reading_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        return shifted(reading_m, delay_s_in(scene), scene.rate_Hz)

    return Fault(
        acts=(Act(name=EFFECT.name, place=Place.SENSOR, change=change),), numbers={key: number}
    )


def _change(trace: Trace, delay_s: float) -> Array:
    still = trace.displacement_m
    return shifted(still, delay_s, trace.scene.rate_Hz) - still


def _change_by_rows(trace: Trace, rows: float) -> Array:
    return _change(trace, rows / trace.scene.record_rate_Hz)


EFFECT = Effect(
    name="delay",
    measure=Measure.RMS,
    visible_percent=0.25,
    shown_by=("rates", "chirp"),
    install=install,
)
