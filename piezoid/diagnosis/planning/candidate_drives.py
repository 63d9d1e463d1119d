"""Candidate experiments of a plan, each with its drive.

Each drive begins with cycles over the whole range, and begins and ends at rest. Slow drives are
played at a part of the converter's clock, so that a file of minutes stays readable.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.planning.drive_limits import Bench, Drive, DriveLimits
from piezoid.diagnosis.planning.waveforms import (
    decaying_loops,
    equal_cycles,
    held_levels,
    multisine_period,
    odd_lines,
    path_V,
    rest_V,
    reversal_curves,
    rising_ramps,
    sine_grid,
    with_lead_in,
)
from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array

SLOW_Hz = 500.0
SLOWER_Hz = 100.0
AMPLITUDES = (1.0, 0.3, 0.1)  # of the grid of sines, of half the range
GRID_Hz = (0.97, 3.1, 9.7, 31.0, 97.0, 310.0)  # low harmonics miss the mains
ROWS = 20.0  # of the fastest sine
RAMP_ROWS = 1000.0  # of the fastest triangle
MULTISINE_RMS = 0.02  # of half the range, before the slew limit
MULTISINE_PERIODS = 10

Voltages = tuple[float, Array, dict[str, Array]]  # rate in Hz, (samples,) volts, and of other axes
VoltageFunction = Callable[[Bench, np.random.Generator], Voltages]
Waveform = Callable[[Bench, float, np.random.Generator], Array]  # (..., rate in Hz, ...) -> volts


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A candidate drive.

    name         of the drive
    why          purpose, in one sentence
    drive        (bench, generator) -> rate in Hz, (samples,) volts of the axis, and of other axes
    needs_other  whether another axis must be driven
    """

    name: str
    why: str
    drive: VoltageFunction
    needs_other: bool = False


def drive_of(experiment: Experiment, bench: Bench, seed: int) -> Drive:
    """Return the drive of an experiment on a bench; the same seed gives the same drive.

    Raises ``ExcitationError`` where the bench cannot play it.
    """
    if experiment.needs_other and not bench.other_limits:
        raise ExcitationError(
            "no other axis is known to the model or to lab.toml",
            needed="another axis that can be driven",
            remedy="Record its drive as well.",
        )
    rate_Hz, voltage_V, others_V = experiment.drive(bench, np.random.default_rng(seed))
    low_V, high_V = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    return Drive(
        name=experiment.name,
        why=experiment.why,
        sampling_rate_Hz=rate_Hz,
        axes=(bench.axis, *others_V),
        voltage_V=np.column_stack([np.clip(voltage_V, low_V, high_V), *others_V.values()]),
    )


def divided_clock_Hz(clock_Hz: float, highest_Hz: float) -> float:
    """Return the clock divided by the smallest integer such that it is not above a rate."""
    return clock_Hz / max(int(np.ceil(clock_Hz / highest_Hz - 1e-9)), 1)


def at_rate(highest_Hz: float, waveform: Waveform) -> VoltageFunction:
    """Return a function for the drive of this axis alone, at the clock divided by an integer.

    highest_Hz  largest rate at which the drive is played
    """

    def drive(bench: Bench, rng: np.random.Generator) -> Voltages:
        rate_Hz = divided_clock_Hz(bench.clock_Hz, highest_Hz)
        return rate_Hz, with_lead_in(waveform(bench, rate_Hz, rng), rate_Hz, bench.limits), {}

    return drive


def _small_multisine(bench: Bench, rate_Hz: float, rng: np.random.Generator) -> Array:
    limits, samples = bench.limits, round(rate_Hz)
    low_V, high_V = limits.voltage_min_V, limits.voltage_max_V
    lines = odd_lines(5.0, rate_Hz / 10.0, 1.0, left_out_of=4, rng=rng)
    # the rms speed of equal lines, with room for a peak of four times as much
    rms_rad_per_s = 2 * np.pi * float(np.sqrt(np.mean(lines.astype(float) ** 2)))
    rms_V = min(MULTISINE_RMS * (high_V - low_V) / 2, limits.slew_V_per_s / (5.0 * rms_rad_per_s))
    period_V = 0.5 * (low_V + high_V) + rms_V * multisine_period(lines, samples, rng)
    slew_V_per_s = float(np.abs(np.diff(period_V, append=period_V[0])).max()) * rate_Hz
    if slew_V_per_s > limits.slew_V_per_s:
        raise ExcitationError(
            f"the multisine moves at up to {slew_V_per_s:.4g} V/s",
            needed=f"at most {limits.slew_V_per_s:g} V/s",
            remedy="Allow a larger slew_V_per_s, or a lower sampling rate.",
        )
    return np.tile(period_V, MULTISINE_PERIODS)


def _other_axes(bench: Bench, _: np.random.Generator) -> Voltages:
    """Hold this axis at mid-range while every other axis runs decaying loops."""
    rate_Hz = divided_clock_Hz(bench.clock_Hz, SLOW_Hz)
    second, middle_V = round(rate_Hz), 0.5 * sum(bench.limits.range_V)
    loops = {
        axis: decaying_loops(limits, rate_Hz, frequency_Hz=0.7, cycles=10)
        for axis, limits in bench.other_limits.items()
    }
    approach = {
        axis: path_V([rest_V(limits), float(loops[axis][0])], limits, rate_Hz, move_s=1.0)
        for axis, limits in bench.other_limits.items()
    }
    longest = max(map(len, loops.values()))
    own_V = with_lead_in(np.full(longest + 2 * second, middle_V), rate_Hz, bench.limits)
    settled = int(np.flatnonzero(own_V == middle_V)[-longest - second])
    begin = max(settled, *map(len, approach.values()))
    own_V = np.pad(own_V, (begin - settled, 0), mode="edge")
    others_V = {}
    for axis, limits in bench.other_limits.items():
        zero_V, loop_V = rest_V(limits), loops[axis]
        wait_V = np.full(begin - len(approach[axis]), zero_V)
        return_V = path_V([float(loop_V[-1]), zero_V], limits, rate_Hz, move_s=1.0)
        others_V[axis] = np.concatenate([wait_V, approach[axis], loop_V, return_V])
    samples = max(len(own_V), *map(len, others_V.values()))

    def padded(drive_V: Array) -> Array:
        return np.pad(drive_V, (0, samples - len(drive_V)), mode="edge")

    return rate_Hz, padded(own_V), {axis: padded(drive_V) for axis, drive_V in others_V.items()}


def _ramps(bench: Bench, rng: np.random.Generator) -> Voltages:
    low_V, high_V = bench.limits.range_V
    fastest_Hz = bench.limits.slew_V_per_s / (2.0 * (high_V - low_V))
    drive = at_rate(
        max(RAMP_ROWS * fastest_Hz, SLOWER_Hz),
        lambda b, f, _: rising_ramps(b.limits, f, slowest=0.1, steps=8),
    )
    return drive(bench, rng)


def _held_levels(levels: int, *, mirrored: bool) -> VoltageFunction:
    return at_rate(
        SLOWER_Hz,
        lambda b, f, rng: held_levels(
            b.limits, f, levels=levels, hold_s=8.0, mirrored=mirrored, rng=rng
        ),
    )


def _constant_drive(limits: DriveLimits, rate_Hz: float, time_s: float) -> Array:
    return np.full(round(time_s * rate_Hz), 0.5 * sum(limits.range_V))


EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        name="quasi_static_loops",
        why="Slow nested minor loops: hysteresis without creep or dynamics.",
        drive=at_rate(
            SLOW_Hz, lambda b, f, _: decaying_loops(b.limits, f, frequency_Hz=0.5, cycles=12)
        ),
    ),
    Experiment(
        name="reversal_curves",
        why="First-order reversal curves: from the top down to ten ever lower turns and back.",
        drive=at_rate(
            SLOW_Hz, lambda b, f, _: reversal_curves(b.limits, f, curves=10, move_s=1.0)
        ),
    ),
    Experiment(
        name="held_levels",
        why="Random levels, each held: motion at constant drive, with the sign of the step.",
        drive=_held_levels(20, mirrored=False),
    ),
    Experiment(
        name="held_levels_mirrored",
        why="Random levels and the same mirrored: creep changes sign with the steps, drift "
        "does not.",
        drive=_held_levels(10, mirrored=True),
    ),
    Experiment(
        name="sine_grid",
        why="Sines of every amplitude at every frequency: which errors grow with speed, and at "
        "which amplitudes.",
        drive=at_rate(
            ROWS * max(GRID_Hz),
            lambda b, f, _: sine_grid(
                b.limits,
                f,
                shares=AMPLITUDES,
                frequencies_Hz=[line_Hz for line_Hz in GRID_Hz if line_Hz <= f / ROWS],
                block_s=0.5,
            ),
        ),
    ),
    Experiment(
        name="small_multisine",
        why="Small motion up to a tenth of the sampling rate: gain and phase without hysteresis.",
        drive=at_rate(np.inf, _small_multisine),  # at the clock itself
    ),
    Experiment(
        name="other_axis",
        why="This axis at constant drive while the others move: cross-coupling.",
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
        why="Five minutes at one level: creep and drift.",
        drive=at_rate(SLOWER_Hz, lambda b, f, _: _constant_drive(b.limits, f, 300.0)),
    ),
    Experiment(
        name="idle",
        why="The drive at rest, sampled fast: the sensor noise and disturbances.",
        drive=at_rate(2000.0, lambda b, f, _: _constant_drive(b.limits, f, 20.0)),
    ),
    Experiment(
        name="equal_cycles",
        why="The same full cycle many times: changes with time.",
        drive=at_rate(
            SLOW_Hz, lambda b, f, _: equal_cycles(b.limits, f, frequency_Hz=0.97, cycles=40)
        ),
    ),
    Experiment(
        name="slow_ramp",
        why="The whole range once, slowly, up and down.",
        drive=at_rate(
            1000.0,
            lambda b, f, _: path_V(
                [*b.limits.range_V, b.limits.voltage_min_V], b.limits, f, move_s=40.0
            ),
        ),
    ),
)
