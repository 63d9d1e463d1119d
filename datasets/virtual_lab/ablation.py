"""How large a hidden effect really is: record again without it, and compare."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import Bench, Effect, Fault, Measure
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, follow, record


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """One effect that is in the recordings.

    measure           how sizes are read, in the recording where they are largest
    asked_percent     of the stroke: the size it was scaled to on the healthy bench
    measured_percent  the size it has: what changes when it alone is taken out again
    change_percent    rms of that change in each recording, by name
    moving_percent    the largest rms of it about its own mean: where a zero is nobody's
    numbers           the physical parameters, units in their names
    """

    name: str
    measure: Measure
    asked_percent: float
    measured_percent: float
    change_percent: Mapping[str, float]
    moving_percent: float
    numbers: Mapping[str, float | str]


def healthy(stage: Stage, runs: Sequence[Run]) -> Bench:
    """Follow every run with nothing wrong: what effects scale themselves by."""
    sound = replace(stage, acts=())
    traces = tuple(follow(sound, run, order) for order, run in enumerate(runs))
    return Bench(rig=stage.rig, ceramic=stage.ceramic, traces=traces)


def record_all(stage: Stage, runs: Sequence[Run], faults: Mapping[str, Fault]) -> tuple[Rows, ...]:
    """Record every run with these faults installed."""
    faulty = replace(stage, acts=tuple(act for fault in faults.values() for act in fault.acts))
    return tuple(record(faulty, run, order) for order, run in enumerate(runs))


def taken_out(
    effect: Effect,
    asked_percent: float,
    stage: Stage,
    runs: Sequence[Run],
    faults: Mapping[str, Fault],
    recordings: Sequence[Rows],
) -> HiddenEffect:
    """Measure what one effect does to the noise-free reading, all others staying in place."""
    others = {name: fault for name, fault in faults.items() if name != effect.name}
    without = record_all(stage, runs, others)
    changes = {a.run.name: change_m(a, b) for a, b in zip(recordings, without, strict=True)}
    percent = 100.0 / stage.rig.stroke_m
    return HiddenEffect(
        name=effect.name,
        measure=effect.measure,
        asked_percent=asked_percent,
        measured_percent=percent * max(effect.measure.of(change) for change in changes.values()),
        change_percent={
            name: percent * Measure.RMS.of(change) for name, change in changes.items()
        },
        moving_percent=percent * max(float(np.std(change)) for change in changes.values()),
        numbers=faults[effect.name].numbers,
    )


def change_m(one: Rows, other: Rows) -> Array:
    """Return the difference of two recordings of one run, over the rows both have."""
    count = min(len(one.noise_free_m), len(other.noise_free_m))
    return one.noise_free_m[:count] - other.noise_free_m[:count]
