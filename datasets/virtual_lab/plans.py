"""Plans: the recordings that a laboratory makes of one stage.

A laboratory cycles the drive twice over its range before a recording. Exceptions are the effect
``initial_state``, and ``careless_history_V`` for a laboratory that never cycles.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array
from piezoid_datasets.virtual_lab.stage import Run

CYCLES_BEFORE = 2
Shapes = tuple[float, Array, dict[str, Array]]
Past = Callable[[Rig, np.random.Generator], Array]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One type of recording.

    name   of its file
    shape  (rig, rng) -> rate of the rows in Hz, drive between -1 and 1, drives of other axes
    """

    name: str
    shape: Callable[[Rig, np.random.Generator], Shapes]


def run_of(plan: Plan, rig: Rig, rng: np.random.Generator, *, past_V: Past | None = None) -> Run:
    """Return a run of a plan on a rig.

    past_V  (rig, rng) -> turning points before the recording; None: two cycles over the range
    """
    rate_Hz, shape, other_drives = plan.shape(rig, rng)
    history = cycled_history_V(rig) if past_V is None else past_V(rig, rng)
    return Run(
        name=plan.name,
        sampling_rate_Hz=rate_Hz,
        command_V=volts_of(rig, shape),
        history_V=history,
        rest_s=float(rng.uniform(20.0, 300.0)),
        others_V={axis: volts_of(rig, drive) for axis, drive in other_drives.items()},
    )


def cycled_history_V(rig: Rig) -> Array:
    """Return the turning points of a drive that was cycled over its full range."""
    return np.array([rig.drive_max_V, rig.drive_min_V] * CYCLES_BEFORE)


def careless_history_V(rig: Rig, rng: np.random.Generator) -> Array:
    """Return random turning points in the range, alternately in its upper and lower half."""
    middle_V = 0.5 * (rig.drive_min_V + rig.drive_max_V)
    high_V = rng.uniform(middle_V, rig.drive_max_V, 3)
    low_V = rng.uniform(rig.drive_min_V, middle_V, 3)
    return np.column_stack((high_V, low_V)).ravel()


def sweep(_: Rig, rng: np.random.Generator) -> Shapes:
    """A decaying sweep, nested loops, and full cycles."""
    rate_Hz = float(rng.choice([500.0, 1000.0]))
    frequency_Hz = float(rng.choice([0.5, 0.7, 1.3]))
    cycles = int(rng.integers(8, 14))
    triangle = bool(rng.random() < 0.6)
    shape = drives.decaying_sweep(rate_Hz, frequency_Hz, cycles, triangle=triangle)
    loops = drives.nested_loops(rate_Hz, 4.0 * frequency_Hz, (1.0, -0.2, 0.5, -0.7, 0.3, -1.0))
    full_cycles = drives.decaying_sweep(rate_Hz, frequency_Hz, 4, keep=1.0, triangle=triangle)
    return rate_Hz, np.concatenate((shape, loops, full_cycles)), {}


def check(_: Rig, rng: np.random.Generator) -> Shapes:
    """Moves between random levels."""
    rate_Hz = float(rng.choice([500.0, 1000.0]))
    move_s = float(rng.uniform(0.2, 0.8))
    return rate_Hz, drives.random_levels(rate_Hz, move_s, int(rng.integers(30, 50)), rng), {}


def rates(rig: Rig, rng: np.random.Generator) -> Shapes:
    """Full loops at three frequencies."""
    rate_Hz = rig.clock_Hz / float(rng.choice([1.0, 2.0]))
    fast_Hz = float(rng.uniform(30.0, 90.0))
    plan = ((2.3, 2), (11.0, 5), (fast_Hz, round(0.4 * fast_Hz)))
    return rate_Hz, drives.rates(rate_Hz, plan, triangle=bool(rng.random() < 0.5)), {}


def staircase(_: Rig, rng: np.random.Generator) -> Shapes:
    """Random levels, each held."""
    hold_s = float(rng.uniform(1.5, 4.0))
    return 500.0, drives.staircase(500.0, 0.05, hold_s, int(rng.integers(9, 14)), rng), {}


def chirp(rig: Rig, rng: np.random.Generator) -> Shapes:
    """A small sine of rising frequency."""
    high_Hz = float(rng.uniform(400.0, 1500.0))
    amplitude = float(rng.uniform(0.06, 0.15))
    return rig.clock_Hz, drives.chirp(rig.clock_Hz, 5.0, high_Hz, 1.6, amplitude), {}


def other_axis(_: Rig, rng: np.random.Generator) -> Shapes:
    """A slow sine while another axis sweeps."""
    rate_Hz, time_s = 500.0, 16.0
    slow = 0.5 * np.sin(2.0 * np.pi * 0.19 * np.arange(round(time_s * rate_Hz)) / rate_Hz)
    up = drives.glide(rate_Hz, -1.0, 0.0, 2.0)
    shape = np.concatenate((up, slow, drives.glide(rate_Hz, float(slow[-1]), -1.0, 2.0)))
    drive = drives.decaying_sweep(rate_Hz, float(rng.uniform(0.5, 0.9)), 8)
    still = np.full(max(len(shape) - len(drive), 0) // 2, -1.0)
    moves = np.concatenate((still, drive, np.full(len(shape), -1.0)))[: len(shape)]
    return rate_Hz, shape, {"y": moves}


def long_hold(_: Rig, rng: np.random.Generator) -> Shapes:
    """A level held for minutes."""
    level = float(rng.uniform(-0.3, 0.5))
    return 100.0, drives.long_hold(100.0, 1.0, level, float(rng.uniform(90.0, 240.0))), {}


PLANS = tuple(
    Plan(name=shape.__name__, shape=shape)
    for shape in (sweep, check, rates, staircase, chirp, other_axis, long_hold)
)


def volts_of(rig: Rig, shape: Array) -> Array:
    """Convert a drive between -1 and 1 to volts."""
    return rig.drive_min_V + 0.5 * (shape + 1.0) * (rig.drive_max_V - rig.drive_min_V)
