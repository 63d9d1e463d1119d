"""Candidate experiments of a plan, each with its drive.

Each drive begins with two cycles over the whole range, which determine the initial state of every
play, and begins and ends at rest. Every waveform stays within the limits. Slow drives are played
at a part of the converter's clock, so that a file of minutes stays readable.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.planning.drive_limits import Bench, Drive, DriveLimits
from piezoid.errors import ExcitationError
from piezoid.numerics.arrays import Array

SLOW_Hz = 500.0
SLOWER_Hz = 100.0
AMPLITUDES = (0.1, 0.3, 1.0)  # of the grid of sines, of half the range
GRID_Hz = (310.0, 97.0, 31.0, 9.7, 3.1, 0.97)  # low harmonics miss the mains
SINE_s, MIN_CYCLES = 0.5, 3  # of one sine of the grid
ROWS = 20.0  # of the fastest sine
RAMP_ROWS = 1000.0  # of the fastest triangle
RAMP_SHARES = np.geomspace(0.1, 1.0, 8)  # speeds of the triangles, of the slew limit
MULTISINE_BAND = 0.1  # of the sampling rate; no other drive has faster sines
MULTISINE_RMS = 0.02  # of half the range, before the slew limit
MULTISINE_PERIODS = 10
CREST_TRIALS = 20  # draws of phases; the one with the lowest peak is taken
CYCLES_BEFORE = 2
CYCLE_s = 2.0  # of one such cycle, where the slew limit allows
FULL_AT_Hz = 100.0  # fastest sine of the full range, to protect the mechanics
GLIDE = np.pi / 2  # peak speed of half a cosine over its mean speed
TRIANGLE, SINE = 4.5, 2 * np.pi  # speeds in half ranges per period, with a margin for a triangle
CURVES = 10  # first-order reversal curves
HOLD_s = 8.0  # of a level


@dataclass(frozen=True, kw_only=True)
class Playback:
    """Limits and rate at which a waveform is played.

    limits   of the drive
    rate_Hz  sampling rate
    rng      random numbers of the waveform
    """

    limits: DriveLimits
    rate_Hz: float
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def phase(self, frequency_Hz: float, cycles: int, speed: float) -> Array:
        """Return the phase in periods, slower if the slew limit requires it.

        speed  largest speed of the waveform, in half ranges per period
        """
        limits = self.limits
        frequency_Hz = min(frequency_Hz, limits.slew_V_per_s / (speed * limits.reach_V))
        samples = np.arange(round(cycles / frequency_Hz * self.rate_Hz))
        return np.asarray(samples * frequency_Hz / self.rate_Hz)

    def path_V(self, stops_V: Sequence[float], *, move_s: float, hold_s: float = 0.0) -> Array:
        """Return a drive through voltages, with half-cosine moves and holds.

        move_s  of each move; longer if the slew limit requires it
        """
        parts = [np.array([stops_V[0]])]
        for start_V, stop_V in pairwise(stops_V):
            time_s = max(move_s, GLIDE * abs(stop_V - start_V) / self.limits.slew_V_per_s)
            count = max(int(np.ceil(time_s * self.rate_Hz)), 1)
            share = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, count + 1) / count))
            hold_V = np.full(round(hold_s * self.rate_Hz), stop_V)
            parts += [start_V + (stop_V - start_V) * share, hold_V]
        return np.concatenate(parts)

    def with_lead_in(self, body_V: Array) -> Array:
        """Return a drive after cycles over the whole range, followed by a return to rest."""
        limits, (first_V, last_V) = self.limits, body_V[[0, -1]].tolist()
        full_cycle_V = (limits.voltage_max_V, limits.voltage_min_V)
        stops_V = [limits.rest_V, *full_cycle_V * CYCLES_BEFORE, first_V]
        lead_in_V = self.path_V(stops_V, move_s=CYCLE_s / 2)
        return_V = self.path_V([last_V, limits.rest_V], move_s=CYCLE_s / 2)
        return np.concatenate([lead_in_V, body_V, return_V])


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A candidate drive.

    name        of the drive
    why         purpose, in one sentence
    waveform    (playback) -> (samples,) volts of the axis; None: the axis rests while every other
                axis moves
    highest_Hz  largest rate at which it is played, or a function of the limits
    """

    name: str
    why: str
    waveform: Callable[[Playback], Array] | None
    highest_Hz: float | Callable[[DriveLimits], float] = SLOW_Hz


def drive_of(experiment: Experiment, bench: Bench, seed: int) -> Drive:
    """Return the drive of an experiment on a bench; the same seed gives the same drive.

    Raises ``ExcitationError`` where the bench cannot play it.
    """
    limits, highest_Hz = bench.limits, experiment.highest_Hz
    highest_Hz = highest_Hz(limits) if callable(highest_Hz) else highest_Hz
    rate_Hz = bench.clock_Hz / max(int(np.ceil(bench.clock_Hz / highest_Hz - 1e-9)), 1)
    if experiment.waveform is None:
        voltage_V, others_V = _other_axes(bench, rate_Hz)
    else:
        playback = Playback(limits=limits, rate_Hz=rate_Hz, rng=np.random.default_rng(seed))
        voltage_V, others_V = playback.with_lead_in(experiment.waveform(playback)), {}
    return Drive(
        name=experiment.name,
        why=experiment.why,
        sampling_rate_Hz=rate_Hz,
        axes=(bench.axis, *others_V),
        voltage_V=np.column_stack([np.clip(voltage_V, *limits.range_V), *others_V.values()]),
    )


def decaying_loops(playback: Playback, *, frequency_Hz: float, cycles: int) -> Array:
    """Return triangles about the middle with decaying amplitude: nested minor loops."""
    phase = playback.phase(frequency_Hz, cycles, TRIANGLE)
    amplitude_V = playback.limits.reach_V * (1.0 - phase / cycles)
    return playback.limits.middle_V + amplitude_V * _triangle(phase)


def equal_cycles(playback: Playback, *, frequency_Hz: float, cycles: int) -> Array:
    """Return equal sine cycles."""
    wave = np.sin(2 * np.pi * playback.phase(frequency_Hz, cycles, SINE))
    return np.asarray(playback.limits.middle_V + playback.limits.reach_V * wave)


def reversal_curves(playback: Playback) -> Array:
    """Return first-order reversal curves: from the top down to ever lower turns and back."""
    low_V, top_V = playback.limits.range_V
    turns_V = np.linspace(top_V, low_V, CURVES + 1)[1:].tolist()
    stops_V = [top_V, *(stop_V for turn_V in turns_V for stop_V in (turn_V, top_V))]
    return playback.path_V(stops_V, move_s=1.0)


def held_levels(playback: Playback, *, levels: int, mirrored: bool = False) -> Array:
    """Return random levels, each held; if ``mirrored``, followed by their mirror image."""
    limits = playback.limits
    shares = playback.rng.uniform(-0.95, 0.95, levels)
    shares = np.concatenate([shares, -shares]) if mirrored else shares
    levels_V = (limits.middle_V + limits.reach_V * shares).tolist()
    return playback.path_V([limits.voltage_min_V, *levels_V], move_s=0.05, hold_s=HOLD_s)


def sine_grid(playback: Playback) -> Array:
    """Return sines of every amplitude and frequency in the slew limit, small and fast first."""
    limits, rate_Hz = playback.limits, playback.rate_Hz
    parts = [np.array([limits.middle_V])]
    for share in AMPLITUDES:
        for frequency_Hz in GRID_Hz:
            speed_V_per_s = 2 * np.pi * frequency_Hz * share * limits.reach_V
            is_too_fast = speed_V_per_s > limits.slew_V_per_s or share * frequency_Hz > FULL_AT_Hz
            if is_too_fast or frequency_Hz > rate_Hz / ROWS:
                continue
            cycles = max(round(SINE_s * frequency_Hz), MIN_CYCLES)
            count = round(cycles / frequency_Hz * rate_Hz)
            phase = cycles * np.arange(1, count + 1) / count
            parts.append(limits.middle_V + share * limits.reach_V * np.sin(2 * np.pi * phase))
    return np.concatenate(parts)


def rising_ramps(playback: Playback) -> Array:
    """Return full triangles whose speed rises from a share of the slew limit up to it."""
    limits = playback.limits
    parts = [np.array([limits.voltage_min_V])]
    for share in RAMP_SHARES:
        frequency_Hz = share * limits.slew_V_per_s / (TRIANGLE * limits.reach_V)
        count = max(round(2.0 / frequency_Hz * playback.rate_Hz), 8)
        phase = 2.0 * np.arange(1, count + 1) / count
        parts.append(limits.voltage_min_V + limits.reach_V * (1.0 + _triangle(phase - 0.25)))
    return np.concatenate(parts)


def constant_drive(playback: Playback, *, time_s: float) -> Array:
    """Return mid-range."""
    return np.full(round(time_s * playback.rate_Hz), playback.limits.middle_V)


def small_multisine(playback: Playback) -> Array:
    """Return periods of a small multisine about mid-range.

    Raises ``ExcitationError`` if it exceeds the slew limit.
    """
    limits, rate_Hz, rng = playback.limits, playback.rate_Hz, playback.rng
    lines = odd_lines(5.0, MULTISINE_BAND * rate_Hz, 1.0, left_out_of=4, rng=rng)
    # the rms speed of equal lines, with room for a peak of four times as much
    rms_rad_per_s = 2 * np.pi * float(np.sqrt(np.mean(lines.astype(float) ** 2)))
    rms_V = min(MULTISINE_RMS * limits.reach_V, limits.slew_V_per_s / (5.0 * rms_rad_per_s))
    period_V = limits.middle_V + rms_V * multisine_period(lines, round(rate_Hz), rng)
    slew_V_per_s = float(np.abs(np.diff(period_V, append=period_V[0])).max()) * rate_Hz
    if slew_V_per_s > limits.slew_V_per_s:
        raise ExcitationError(
            f"the multisine moves at up to {slew_V_per_s:.4g} V/s",
            needed=f"at most {limits.slew_V_per_s:g} V/s",
            remedy="Allow a larger slew_V_per_s, or a lower sampling rate.",
        )
    return np.tile(period_V, MULTISINE_PERIODS)


def odd_lines(
    lowest_Hz: float,
    highest_Hz: float,
    resolution_Hz: float,
    *,
    left_out_of: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return odd multiples of the resolution in a band, with one of each group left out at random.

    left_out_of  size of a group; the line left out detects odd distortion, as all even lines
                 detect even distortion. 0: no line is left out
    """
    first = int(np.ceil(lowest_Hz / resolution_Hz))
    lines = np.arange(first + 1 - first % 2, int(highest_Hz / resolution_Hz) + 1, 2)
    if left_out_of > 1:
        groups = len(lines) // left_out_of
        silent = np.arange(groups) * left_out_of + rng.integers(0, left_out_of, groups)
        lines = np.delete(lines, silent)
    return np.asarray(lines, dtype=np.int64)


def multisine_period(lines: NDArray[np.int64], samples: int, rng: np.random.Generator) -> Array:
    """Return one period of a random-phase multisine of equal lines and rms 1, (samples,).

        u(t) = sum_k cos(2 pi k f_0 t + phi_k)         [Pintelon & Schoukens 2012]

    Of several draws of the phases the one with the lowest peak is taken.

    lines  multiples of the inverse period that it contains
    """

    def period(phase_rad: Array) -> Array:
        spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
        spectrum[lines] = np.exp(1j * phase_rad)
        wave = np.fft.irfft(spectrum, samples)
        return np.asarray(wave / np.sqrt(np.mean(wave**2)))

    draws = rng.uniform(0.0, 2.0 * np.pi, (CREST_TRIALS, len(lines)))
    return min((period(draw) for draw in draws), key=lambda wave: float(np.abs(wave).max()))


def _other_axes(bench: Bench, rate_Hz: float) -> tuple[Array, dict[str, Array]]:
    """Hold this axis at mid-range while every other axis runs decaying loops."""
    if not bench.other_limits:
        raise ExcitationError(
            "no other axis is known to the model or to lab.toml",
            needed="another axis that can be driven",
            remedy="Record its drive as well.",
        )
    loops_V, approaches_V, returns_V = {}, {}, {}
    for axis, limits in bench.other_limits.items():
        playback = Playback(limits=limits, rate_Hz=rate_Hz)
        loops_V[axis] = decaying_loops(playback, frequency_Hz=0.7, cycles=10)
        first_V, last_V = loops_V[axis][[0, -1]].tolist()
        approaches_V[axis] = playback.path_V([limits.rest_V, first_V], move_s=1.0)
        returns_V[axis] = playback.path_V([last_V, limits.rest_V], move_s=1.0)
    second, middle_V = round(rate_Hz), bench.limits.middle_V
    longest = max(map(len, loops_V.values()))
    rest_V = np.full(longest + 2 * second, middle_V)
    own_V = Playback(limits=bench.limits, rate_Hz=rate_Hz).with_lead_in(rest_V)
    # all loops begin together, a second after this axis has reached mid-range or later
    settled = int(np.flatnonzero(own_V == middle_V)[-longest - second])
    begin = max(settled, *map(len, approaches_V.values()))
    drives_V = {bench.axis: np.pad(own_V, (begin - settled, 0), mode="edge")}
    for axis, approach_V in approaches_V.items():
        move_V = np.concatenate([approach_V, loops_V[axis], returns_V[axis]])
        drives_V[axis] = np.pad(move_V, (begin - len(approach_V), 0), mode="edge")
    samples = max(map(len, drives_V.values()))
    others_V = {
        axis: np.pad(drive_V, (0, samples - len(drive_V)), mode="edge")
        for axis, drive_V in drives_V.items()
    }
    return others_V.pop(bench.axis), others_V


def _triangle(phase: Array) -> Array:
    """Return a triangle with the reversals of the sine of 2 pi phase."""
    return np.asarray(2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase)))


EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment(
        name="quasi_static_loops",
        why="Slow nested minor loops: hysteresis without creep or dynamics.",
        waveform=partial(decaying_loops, frequency_Hz=0.5, cycles=12),
    ),
    Experiment(
        name="reversal_curves",
        why="First-order reversal curves: from the top down to ten ever lower turns and back.",
        waveform=reversal_curves,
    ),
    Experiment(
        name="held_levels",
        why="Random levels, each held: motion at constant drive, with the sign of the step.",
        waveform=partial(held_levels, levels=20),
        highest_Hz=SLOWER_Hz,
    ),
    Experiment(
        name="held_levels_mirrored",
        why="Random levels and the same mirrored: creep changes sign with the steps, drift "
        "does not.",
        waveform=partial(held_levels, levels=10, mirrored=True),
        highest_Hz=SLOWER_Hz,
    ),
    Experiment(
        name="sine_grid",
        why="Sines of every amplitude at every frequency: which errors grow with speed, and at "
        "which amplitudes.",
        waveform=sine_grid,
        highest_Hz=ROWS * max(GRID_Hz),
    ),
    Experiment(
        name="small_multisine",
        why="Small motion up to a tenth of the sampling rate: gain and phase without hysteresis.",
        waveform=small_multisine,
        highest_Hz=np.inf,  # the clock itself
    ),
    Experiment(
        name="other_axis",
        why="This axis at constant drive while the others move: cross-coupling.",
        waveform=None,
    ),
    Experiment(
        name="fast_ramps",
        why="Full triangles at rising speed up to the slew limit.",
        waveform=rising_ramps,
        # resolves the fastest triangle
        highest_Hz=lambda limits: max(
            RAMP_ROWS * (limits.slew_V_per_s / (2.0 * float(np.ptp(limits.range_V)))), SLOWER_Hz
        ),
    ),
    Experiment(
        name="long_hold",
        why="Five minutes at one level: creep and drift.",
        waveform=partial(constant_drive, time_s=300.0),
        highest_Hz=SLOWER_Hz,
    ),
    Experiment(
        name="idle",
        why="The drive at rest, sampled fast: the sensor noise and disturbances.",
        waveform=partial(constant_drive, time_s=20.0),
        highest_Hz=2000.0,
    ),
    Experiment(
        name="equal_cycles",
        why="The same full cycle many times: changes with time.",
        waveform=partial(equal_cycles, frequency_Hz=0.97, cycles=40),
    ),
    Experiment(
        name="slow_ramp",
        why="The whole range once, slowly, up and down.",
        waveform=lambda playback: playback.path_V(
            [*playback.limits.range_V, playback.limits.voltage_min_V], move_s=40.0
        ),
        highest_Hz=1000.0,
    ),
)
