"""The menu: every experiment that can be planned, as one visible tuple."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.planning import drives
from piezoid.diagnosis.planning.bench import Bench
from piezoid.records.excitation import Drive


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One entry.

    name   of the drive
    why    one sentence: what it shows
    drive  (bench, generator) -> rate in Hz, (samples,) volts of the axis, and of other axes
    """

    name: str
    why: str
    drive: Callable[[Bench, np.random.Generator], drives.Made]
    needs_other: bool = False


def played(experiment: Experiment, bench: Bench, seed: int) -> Drive:
    """Return the drive of an experiment on a bench; the same seed gives the same drive."""
    rate_Hz, voltage_V, others_V = experiment.drive(bench, np.random.default_rng(seed))
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    columns = [np.clip(voltage_V, low, high), *others_V.values()]
    return Drive(
        name=experiment.name,
        why=experiment.why,
        sampling_rate_Hz=rate_Hz,
        axes=(bench.axis, *others_V),
        voltage_V=np.column_stack(columns),
    )


MENU: tuple[Experiment, ...] = (
    Experiment(
        name="quasi_static_loops",
        why="Nested minor loops, slow: the hysteresis alone.",
        drive=drives.nested_loops,
    ),
    Experiment(
        name="reversal_curves",
        why="First-order reversal curves: how minor loops depend on where they are.",
        drive=drives.curves,
    ),
    Experiment(
        name="held_levels",
        why="Random levels, each held: what goes on by itself, with the sign of the step.",
        drive=drives.levels,
    ),
    Experiment(
        name="held_levels_mirrored",
        why="Random levels and the same mirrored: creep changes sign with the steps, drift "
        "does not.",
        drive=drives.mirrored_levels,
    ),
    Experiment(
        name="sine_grid",
        why="Sines of every amplitude at every frequency: what grows with speed, and whether "
        "small motion does too.",
        drive=drives.sines,
    ),
    Experiment(
        name="small_multisine",
        why="Small motion up to a tenth of the clock: gain and phase without walls moving.",
        drive=drives.small_multisine,
    ),
    Experiment(
        name="other_axis",
        why="This axis held while the others move: what comes across.",
        drive=drives.other_axes,
        needs_other=True,
    ),
    Experiment(
        name="fast_ramps",
        why="Full triangles at rising speed up to the slew limit.",
        drive=drives.ramps,
    ),
    Experiment(
        name="long_hold",
        why="Five minutes at one level: what moves now, moves by itself.",
        drive=drives.hold,
    ),
    Experiment(
        name="idle",
        why="The drive at rest, sampled fast: the sensor and its surroundings alone.",
        drive=drives.idle,
    ),
    Experiment(
        name="equal_cycles",
        why="The same full cycle over and over: whatever differs came with time.",
        drive=drives.cycles,
    ),
    Experiment(
        name="slow_ramp",
        why="The whole range once, slowly: errors that repeat with displacement, and by how much "
        "a slow loop differs from fast ones.",
        drive=drives.slow_ramp,
    ),
)
