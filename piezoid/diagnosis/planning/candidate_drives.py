"""The menu: every experiment that can be planned, as one visible tuple, with its drive.

Each begins with cycles over the whole range, and begins and ends at rest. Slow ones are played at
a part of the converter's clock, so that a file of minutes stays readable.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.planning.drive_limits import Bench
from piezoid.diagnosis.planning.excitation import Drive, DriveLimits, multisines, odd_lines
from piezoid.diagnosis.planning.full_range_drives import (
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
from piezoid.numerics.arrays import Array

SLOW_Hz = 500.0
SLOWER_Hz = 100.0
SMALL = (1.0, 0.3, 0.1)  # amplitudes of the grid of sines, of half the range
GRID_Hz = (0.97, 3.1, 9.7, 31.0, 97.0, 310.0)  # low harmonics miss the mains
ROWS = 20.0  # of the fastest sine
RAMP_ROWS = 1000.0  # of the fastest triangle
MULTISINE_RMS = 0.02  # of half the range, before the slew limit
MULTISINE_PERIODS = 10

Made = tuple[float, Array, dict[str, Array]]  # rate in Hz, (samples,) volts, and of other axes
Maker = Callable[[Bench, np.random.Generator], Made]
Body = Callable[[Bench, float, np.random.Generator], Array]  # (..., rate in Hz, ...) -> volts


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One entry.

    name   of the drive
    why    one sentence: what it shows
    drive  (bench, generator) -> rate in Hz, (samples,) volts of the axis, and of other axes
    """

    name: str
    why: str
    drive: Maker
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


def at(wanted_Hz: float, body: Body) -> Maker:
    """Return the drive of this axis alone that plays a body between the cycles and rest.

    wanted_Hz  rate it is played at, where the clock has that part
    """

    def made(bench: Bench, rng: np.random.Generator) -> Made:
        rate_Hz = slower(bench.clock_Hz, wanted_Hz)
        return _alone(bench, rate_Hz, body(bench, rate_Hz, rng))

    return made


def _alone(bench: Bench, rate_Hz: float, body_V: Array) -> Made:
    return rate_Hz, between(body_V, rate_Hz, bench.limits), {}


def _held_levels(bench: Bench, rate_Hz: float, rng: np.random.Generator) -> Array:
    return held_levels(bench.limits, rate_Hz, levels=20, hold_s=8.0, mirrored=False, rng=rng)


def _mirrored_levels(bench: Bench, rate_Hz: float, rng: np.random.Generator) -> Array:
    return held_levels(bench.limits, rate_Hz, levels=10, hold_s=8.0, mirrored=True, rng=rng)


def _sines(bench: Bench, rate_Hz: float, _: np.random.Generator) -> Array:
    usable = [f for f in GRID_Hz if f <= rate_Hz / ROWS]
    return sine_grid(bench.limits, rate_Hz, shares=SMALL, frequencies_Hz=usable, block_s=0.5)


def _small_multisine(bench: Bench, rate_Hz: float, rng: np.random.Generator) -> Array:
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    lines = odd_lines(5.0, rate_Hz / 10.0, 1.0, left_out_of=4, rng=rng)
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
    return drive.voltage_V[:, 0]


def _other_axes(bench: Bench, _: np.random.Generator) -> Made:
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
    there = {axis: _there(move, bench.others[axis], rate_Hz) for axis, move in moves.items()}
    late = max(0, *(len(way) - before for way in there.values()))
    own_V = np.pad(own_V, (late, 0), mode="edge")
    others_V = {}
    for axis, move in moves.items():
        limits, rest = bench.others[axis], rest_V(bench.others[axis])
        back = path_V([float(move[-1]), rest], limits, rate_Hz, move_s=1.0)
        still = np.full(before + late - len(there[axis]), rest)
        others_V[axis] = np.concatenate([still, there[axis], move, back])
    longest = max(len(own_V), *map(len, others_V.values()))
    ended = {axis: _lasting(whole, longest) for axis, whole in others_V.items()}
    return rate_Hz, _lasting(own_V, longest), ended


def _there(move: Array, limits: DriveLimits, rate_Hz: float) -> Array:
    """Return the way from rest to where a move begins."""
    return path_V([rest_V(limits), float(move[0])], limits, rate_Hz, move_s=1.0)


def _lasting(drive: Array, samples: int) -> Array:
    """Return a drive that stays where it ended until the longest has ended."""
    return np.pad(drive, (0, samples - len(drive)), mode="edge")


def _ramps(bench: Bench, _: np.random.Generator) -> Made:
    span_V = bench.limits.voltage_max_V - bench.limits.voltage_min_V
    fastest_Hz = bench.limits.slew_V_per_s / (2.0 * span_V)
    rate_Hz = slower(bench.clock_Hz, max(RAMP_ROWS * fastest_Hz, SLOWER_Hz))
    return _alone(bench, rate_Hz, rising_ramps(bench.limits, rate_Hz, slowest=0.1, steps=8))


def _slow_ramp(bench: Bench, rate_Hz: float, _: np.random.Generator) -> Array:
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    return path_V([low, high, low], bench.limits, rate_Hz, move_s=40.0)


def _still(limits: DriveLimits, rate_Hz: float, time_s: float) -> Array:
    low, high = limits.voltage_min_V, limits.voltage_max_V
    return np.full(round(time_s * rate_Hz), (low + high) / 2)


MENU: tuple[Experiment, ...] = (
    Experiment(
        name="quasi_static_loops",
        why="Nested minor loops, slow: the hysteresis alone.",
        drive=at(
            SLOW_Hz, lambda b, f, _: decaying_loops(b.limits, f, frequency_Hz=0.5, cycles=12)
        ),
    ),
    Experiment(
        name="reversal_curves",
        why="First-order reversal curves: how minor loops depend on where they are.",
        drive=at(SLOW_Hz, lambda b, f, _: reversal_curves(b.limits, f, curves=10, move_s=1.0)),
    ),
    Experiment(
        name="held_levels",
        why="Random levels, each held: what goes on by itself, with the sign of the step.",
        drive=at(SLOWER_Hz, _held_levels),
    ),
    Experiment(
        name="held_levels_mirrored",
        why="Random levels and the same mirrored: creep changes sign with the steps, drift "
        "does not.",
        drive=at(SLOWER_Hz, _mirrored_levels),
    ),
    Experiment(
        name="sine_grid",
        why="Sines of every amplitude at every frequency: what grows with speed, and whether "
        "small motion does too.",
        drive=at(ROWS * max(GRID_Hz), _sines),
    ),
    Experiment(
        name="small_multisine",
        why="Small motion up to a tenth of the clock: gain and phase without walls moving.",
        drive=at(np.inf, _small_multisine),  # at the clock itself
    ),
    Experiment(
        name="other_axis",
        why="This axis held while the others move: what comes across.",
        drive=_other_axes,
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
        drive=at(SLOWER_Hz, lambda b, f, _: _still(b.limits, f, 300.0)),
    ),
    Experiment(
        name="idle",
        why="The drive at rest, sampled fast: the sensor and its surroundings alone.",
        drive=at(2000.0, lambda b, f, _: _still(b.limits, f, 20.0)),
    ),
    Experiment(
        name="equal_cycles",
        why="The same full cycle over and over: whatever differs came with time.",
        drive=at(SLOW_Hz, lambda b, f, _: equal_cycles(b.limits, f, frequency_Hz=0.97, cycles=40)),
    ),
    Experiment(
        name="slow_ramp",
        why="The whole range once, slowly: errors that repeat with displacement, and by how much "
        "a slow loop differs from fast ones.",
        drive=at(1000.0, _slow_ramp),
    ),
)
