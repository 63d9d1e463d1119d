"""The menu: every experiment that can be planned, as one visible tuple.

Each is made inside the limits of amplifier and range, begins with cycles over the whole range, and
begins and ends at rest. Slow ones are played at a part of the converter's clock, so that a file
of minutes stays readable.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.excitation import Drive, DriveLimits
from piezoid.records.large_drives import (
    between,
    decaying_loops,
    equal_cycles,
    held_levels,
    path_V,
    rest_V,
    reversal_curves,
    rising_ramps,
    sine_grid,
)
from piezoid.records.multisine import multisines, odd_lines

SLOW_Hz = 500.0
SLOWER_Hz = 100.0
SMALL = (1.0, 0.3, 0.1)  # amplitudes of the grid of sines, of half the range
GRID_Hz = (0.97, 3.1, 9.7, 31.0, 97.0, 310.0)  # low harmonics miss the mains
RAMP_ROWS = 1000.0  # of the fastest triangle
MULTISINE_RMS = 0.02  # of half the range, before the slew limit
MULTISINE_PERIODS = 10


@dataclass(frozen=True, kw_only=True)
class Bench:
    """What can be played.

    axis      the one to be known better
    limits    of its drive
    clock_Hz  of the converters
    others    limits of other axes that may be driven, by name
    """

    axis: str
    limits: DriveLimits
    clock_Hz: float
    others: Mapping[str, DriveLimits] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One entry.

    name   of the drive
    why    one sentence: what it shows
    drive  (bench, generator) -> rate in Hz, (samples,) volts of the axis, and of other axes
    """

    name: str
    why: str
    drive: Callable[[Bench, np.random.Generator], tuple[float, Array, dict[str, Array]]]
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


def slower(clock_Hz: float, wanted_Hz: float) -> float:
    """Return the largest whole part of the clock that is not above a rate."""
    return clock_Hz / max(int(np.ceil(clock_Hz / wanted_Hz - 1e-9)), 1)


Made = tuple[float, Array, dict[str, Array]]


def _loops(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, SLOW_Hz)
    body_V = decaying_loops(bench.limits, rate_Hz, frequency_Hz=0.5, cycles=12)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _curves(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, SLOW_Hz)
    body_V = reversal_curves(bench.limits, rate_Hz, curves=10, move_s=1.0)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _levels(bench: Bench, rng: np.random.Generator) -> Made:
    return _held(bench, rng, levels=20, hold_s=8.0, mirrored=False)


def _mirrored(bench: Bench, rng: np.random.Generator) -> Made:
    return _held(bench, rng, levels=10, hold_s=8.0, mirrored=True)


def _held(
    bench: Bench, rng: np.random.Generator, *, levels: int, hold_s: float, mirrored: bool
) -> Made:
    rate_Hz = slower(bench.clock_Hz, SLOWER_Hz)
    body_V = held_levels(
        bench.limits, rate_Hz, levels=levels, hold_s=hold_s, mirrored=mirrored, rng=rng
    )
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _sines(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, 20.0 * max(GRID_Hz))
    usable = [f for f in GRID_Hz if f <= rate_Hz / 20.0]
    body_V = sine_grid(bench.limits, rate_Hz, shares=SMALL, frequencies_Hz=usable, block_s=0.5)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _multisine(bench: Bench, rng: np.random.Generator) -> Made:
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    rate_Hz, highest_Hz = bench.clock_Hz, bench.clock_Hz / 10.0
    lines = odd_lines(5.0, highest_Hz, 1.0, left_out_of=4, rng=rng)
    # the rms speed of equal lines, with room for a peak of four times as much
    turning = 2 * np.pi * float(np.sqrt(np.mean(lines.astype(float) ** 2)))
    rms_V = min(MULTISINE_RMS * (high - low) / 2, bench.limits.slew_V_per_s / (5.0 * turning))
    (drive,) = multisines(
        lines,
        period_samples=round(rate_Hz),
        periods=MULTISINE_PERIODS,
        realisations=1,
        rms_V=rms_V,
        offset_V=(low + high) / 2,
        axes=(bench.axis,),
        sampling_rate_Hz=rate_Hz,
        limits=bench.limits,
        rng=rng,
    )
    return rate_Hz, between(drive.voltage_V[:, 0], rate_Hz, bench.limits), {}


def _other(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, SLOW_Hz)
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    moves = {
        axis: decaying_loops(limits, rate_Hz, frequency_Hz=0.7, cycles=10)
        for axis, limits in bench.others.items()
    }
    longest = max(len(move) for move in moves.values())
    still_V = np.full(longest, (low + high) / 2)
    own_V = between(np.pad(still_V, round(rate_Hz), mode="edge"), rate_Hz, bench.limits)
    before = int(np.flatnonzero(own_V == still_V[0])[-len(still_V) - round(rate_Hz)])
    others_V = {}
    for axis, move in moves.items():
        rest = rest_V(bench.others[axis])
        there = path_V([rest, float(move[0])], bench.others[axis], rate_Hz, move_s=1.0)
        back = path_V([float(move[-1]), rest], bench.others[axis], rate_Hz, move_s=1.0)
        whole = np.concatenate([np.full(max(before - len(there), 0), rest), there, move, back])
        after = np.full(max(len(own_V) - len(whole), 0), rest)
        others_V[axis] = np.concatenate([whole, after])
    return rate_Hz, own_V, others_V


def _ramps(bench: Bench, _: np.random.Generator) -> Made:
    span_V = bench.limits.voltage_max_V - bench.limits.voltage_min_V
    fastest_Hz = bench.limits.slew_V_per_s / (2.0 * span_V)
    rate_Hz = slower(bench.clock_Hz, max(RAMP_ROWS * fastest_Hz, SLOWER_Hz))
    body_V = rising_ramps(bench.limits, rate_Hz, slowest=0.1, steps=8)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _hold(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, SLOWER_Hz)
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    body_V = np.full(round(300.0 * rate_Hz), (low + high) / 2)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _idle(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, 2000.0)
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    body_V = np.full(round(20.0 * rate_Hz), (low + high) / 2)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _cycles(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, SLOW_Hz)
    body_V = equal_cycles(bench.limits, rate_Hz, frequency_Hz=0.97, cycles=40)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _slow_ramp(bench: Bench, _: np.random.Generator) -> Made:
    rate_Hz = slower(bench.clock_Hz, 1000.0)
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    body_V = path_V([low, high, low], bench.limits, rate_Hz, move_s=40.0)
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


MENU: tuple[Experiment, ...] = (
    Experiment(
        name="quasi_static_loops",
        why="Nested minor loops, slow: the hysteresis alone.",
        drive=_loops,
    ),
    Experiment(
        name="reversal_curves",
        why="First-order reversal curves: how minor loops depend on where they are.",
        drive=_curves,
    ),
    Experiment(
        name="held_levels",
        why="Random levels, each held: what goes on by itself, with the sign of the step.",
        drive=_levels,
    ),
    Experiment(
        name="held_levels_mirrored",
        why="Random levels and the same mirrored: creep changes sign with the steps, drift "
        "does not.",
        drive=_mirrored,
    ),
    Experiment(
        name="sine_grid",
        why="Sines of every amplitude at every frequency: what grows with speed, and whether "
        "small motion does too.",
        drive=_sines,
    ),
    Experiment(
        name="small_multisine",
        why="Small motion up to a tenth of the clock: gain and phase without walls moving.",
        drive=_multisine,
    ),
    Experiment(
        name="other_axis",
        why="This axis held while the others move: what comes across.",
        drive=_other,
        needs_other=True,
    ),
    Experiment(
        name="fast_ramps",
        why="Full triangles at rising speed up to the slew limit.",
        drive=_ramps,
    ),
    Experiment(
        name="long_hold",
        why="Five minutes at one level: what moves now, moves by itself.",
        drive=_hold,
    ),
    Experiment(
        name="idle",
        why="The drive at rest, sampled fast: the sensor and its surroundings alone.",
        drive=_idle,
    ),
    Experiment(
        name="equal_cycles",
        why="The same full cycle over and over: whatever differs came with time.",
        drive=_cycles,
    ),
    Experiment(
        name="slow_ramp",
        why="The whole range once, slowly: errors that repeat with displacement.",
        drive=_slow_ramp,
    ),
)
