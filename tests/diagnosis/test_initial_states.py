"""Pasts: what is left of a drive once later turns have wiped out earlier ones."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from piezoid.diagnosis.drive_history import DELIBERATE, memory_after, shared_hypotheses
from piezoid.diagnosis.initial_state_search import (
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.nuisance_columns import THRESHOLD
from piezoid.diagnosis.residual_view import with_reversals
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

from .bench import view_of_recordings
from .play_stage import drive
from .played import NOISE, WIDTH, HALF_STROKE_m, moved, recorded_as

HABITS = DELIBERATE + 2  # what a laboratory does on purpose, with the two that end at 0 V

ZERO_VOLTS = -1.3  # in half ranges from the middle of the drive
SELDOM = 6  # samples of a drive for one that is recorded


def left_by(way: Array, memory: Array) -> Array:
    return play_columns(way, THRESHOLD, memory)[1]


def random_drives(seed: int) -> list[Array]:
    """Draw drives of few turns or many that begin anywhere."""
    chance = np.random.default_rng(seed)
    drives = []
    for _ in range(3):
        levels = chance.uniform(-1.0, 1.0, int(chance.integers(1, 60)))
        if seed % 3 == 0:
            levels = np.round(levels, 1)  # so that turns meet again at one value
        first = float(chance.uniform(-1.0, 1.0))
        drives.append(np.array([first, *np.repeat(levels, int(chance.integers(1, 4)))]))
    return drives


@pytest.mark.parametrize("seed", range(12))
def test_turns_that_nothing_wiped_out_leave_the_memory_of_the_whole_drive(seed) -> None:
    drives = random_drives(seed)
    after_another = shared_hypotheses(drives, ZERO_VOLTS)[HABITS:]
    assert len(after_another) == HABITS
    for reversals in after_another:
        memory = memory_after(drives[0], reversals[0])
        for k in (1, 2):
            memory = left_by(np.append(drives[k - 1], drives[k][0]), memory)
            np.testing.assert_array_equal(memory_after(drives[k], reversals[k]), memory)


def after_turns(kind: str, turns: Sequence[float], part: float) -> Recording:
    """Record a part of a drive with a stage of plays and friction that turned there before."""
    rate_Hz, whole = drive(kind)
    field = part * whole[::SELDOM]
    ways = pairwise([0.0, *turns, float(field[0])])
    before = [np.linspace(here, there, 400)[:-1] for here, there in ways]
    way = np.concatenate([*before, field])
    response, _ = moved(way, np.zeros(len(WIDTH)))
    rub = np.zeros(len(way))
    for i, step in enumerate(np.diff(way), start=1):
        rub[i] = rub[i - 1] + step - 2.0 * abs(step) * rub[i - 1]
    response = (response + rub)[-len(field) :]
    noise = np.random.default_rng(len(kind)).normal(0.0, NOISE * np.ptp(response), len(field))
    return recorded_as(kind, rate_Hz / SELDOM, field, HALF_STROKE_m * (response + noise))


@pytest.mark.parametrize(
    ("last", "near"), [((-1.0, 1.0), 1.15), ((0.0,), 1.8)], ids=["cycled", "switched on"]
)
def test_what_a_stage_with_friction_remembers_is_found_though_drives_hardly_tell(
    last, near
) -> None:
    """They go over three fifths of the range, and each began after other turns."""
    turns = ((-1.0, 1.0), (1.0, -1.0), last)
    kinds = {"sweep": 1.0, "walk": 0.6, "waves": 0.6}
    recordings = [
        after_turns(kind, before, part)
        for (kind, part), before in zip(kinds.items(), turns, strict=True)
    ]
    view = view_of_recordings(tuple(recordings), Lab())
    own = with_individual_initial_states(view, with_shared_initial_state(view))
    assert own.rms < near * with_reversals(own, turns).rms
    assert own.rms < 0.5 * view.rms


@pytest.mark.parametrize("phase", np.linspace(0.1, 6.0, 7))
def test_a_drive_that_goes_round_and_round_may_have_run_before_its_recording(phase) -> None:
    turn = np.linspace(0.0, 8 * np.pi, 900)
    sweep, running = np.linspace(-1.0, 1.0, 100), 0.6 * np.sin(turn + phase) - 0.1
    long_before = 0.6 * np.sin(np.linspace(-80.0, 0.0, 9000) + phase) - 0.1
    met = left_by(running[:1], left_by(long_before, np.zeros(len(THRESHOLD))))
    found = [
        memory_after(running, reversals[1])
        for reversals in shared_hypotheses([sweep, running], ZERO_VOLTS)
    ]
    assert len(found) == 4 * HABITS
    assert min(np.abs(memory - met).max() for memory in found) < 2e-3
