"""Timestamp fault: the readings of the sensor shift relative to the drive without notice.

Lost: a buffer overruns and some readings are missing; the file closes the gap, and all later
readings are early. Stalled: the reader repeats its latest value, and all later readings are late.
The time column does not show the fault.

Source: behaviour of acquisition programs on a busy disk.
"""

import math
from collections.abc import Mapping

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Change,
    Effect,
    Fault,
    Measure,
    Place,
    Scene,
    Trace,
)
from piezoid_datasets.virtual_lab.effects.sizing import bisected
from piezoid_datasets.virtual_lab.signals import Array, shifted

ROWS = (0.3, 3000.0)


def install(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Draw type, recordings and instants of the fault; search for the number of rows."""
    kind = str(rng.choice(["lost", "stalled"]))
    worth_m = np.array([EFFECT.measure.of(_late_m(trace, 1.0)) for trace in bench.traces])
    # one row must not be worth more than the size, or no number of rows has it
    liveliest = int(np.argmax(np.where(worth_m <= size_m, worth_m, -worth_m)))
    hit = (worth_m <= worth_m[liveliest]) & (rng.random(len(worth_m)) < 0.5)
    hit[liveliest] = True
    places = {int(order): float(rng.uniform(0.2, 0.6)) for order in np.flatnonzero(hit)}
    struck = [bench.traces[order] for order in places]

    def change(trace: Trace, rows: float) -> Array:
        late_m = _late_m(trace, rows)
        after = np.arange(len(late_m)) > places[trace.scene.order] * len(late_m)
        return np.asarray(np.where(after, late_m, 0.0))

    rows = max(round(bisected(size_m, EFFECT.measure, struck, change, ROWS)), 1)
    numbers: dict[str, float | str] = {"kind": kind, "rows": float(rows)}
    numbers |= {f"place_in_recording_{order}": place for order, place in places.items()}
    act = Act(name=EFFECT.name, place=Place.RECORD, change=_slip(kind, rows, places))
    return Fault(acts=(act,), numbers=numbers)


def _slip(kind: str, rows: int, places: Mapping[int, float]) -> Change:
    def change(sampled_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        if scene.order not in places:
            return sampled_m
        at = math.floor(places[scene.order] * len(sampled_m))
        if kind == "lost":
            return np.delete(sampled_m, slice(at, at + rows))
        hung = np.full(rows, sampled_m[at])
        return np.concatenate((sampled_m[:at], hung, sampled_m[at:]))[: len(sampled_m)]

    return change


def _late_m(trace: Trace, rows: float) -> Array:
    """Return the change of the displacement by a delay of some rows."""
    delay_s = rows / trace.scene.record_rate_Hz
    return shifted(trace.displacement_m, delay_s, trace.scene.rate_Hz) - trace.displacement_m


EFFECT = Effect(
    name="timestamp_fault",
    measure=Measure.RMS,
    visible_percent=0.2,
    shown_by=("rates", "check"),
    install=install,
)
