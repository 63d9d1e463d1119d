"""Size of a hidden effect: difference of the recordings with and without the effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import Bench, Effect, Fault, Measure
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, follow, record


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenEffect:
    """One effect in the recordings; sizes in percent of the stroke.

    measure           definition of the size, in the recording where it is largest
    asked_percent     size to which the effect was scaled on the healthy stage
    measured_percent  actual size: the change if this effect alone is removed
    change_percent    rms of that change in each recording, by name
    moving_percent    largest rms of that change about its mean, which excludes shifts of the zero
    numbers           physical parameters, with units in their names
    """

    name: str
    measure: Measure
    asked_percent: float
    measured_percent: float
    change_percent: Mapping[str, float]
    moving_percent: float
    numbers: Mapping[str, float | str]


def healthy(stage: Stage, runs: Sequence[Run]) -> Bench:
    """Simulate every run without effects, as the reference by which effects are scaled."""
    healthy_stage = replace(stage, acts=())
    traces = tuple(follow(healthy_stage, run, order) for order, run in enumerate(runs))
    return Bench(rig=stage.rig, ceramic=stage.ceramic, traces=traces)


def record_all(stage: Stage, runs: Sequence[Run], faults: Mapping[str, Fault]) -> tuple[Rows, ...]:
    """Record every run with these faults."""
    faulty = replace(stage, acts=tuple(act for fault in faults.values() for act in fault.acts))
    return tuple(record(faulty, run, order) for order, run in enumerate(runs))


def measure_effect(
    effect: Effect,
    asked_percent: float,
    stage: Stage,
    runs: Sequence[Run],
    faults: Mapping[str, Fault],
    recordings: Sequence[Rows],
) -> HiddenEffect:
    """Measure the change of the noise-free readings if one effect is removed."""
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


def change_m(recording: Rows, reference: Rows) -> Array:
    """Return the difference of two recordings of one run, over their common rows."""
    count = min(len(recording.noise_free_m), len(reference.noise_free_m))
    return recording.noise_free_m[:count] - reference.noise_free_m[:count]
