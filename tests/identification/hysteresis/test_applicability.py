"""Data this class of model cannot describe end in a verdict with its reason, not in a bad fit."""

import itertools

import numpy as np
import pytest

from piezoid.identification.fit import fit
from piezoid.identification.hysteresis.applicability import POINTS, loops_of
from tests.identification.hysteresis.stages import (
    RATE_Hz,
    decaying,
    first_order_lag,
    play_sum,
    recording,
    through,
    wandering,
)
from tests.laws import LAWS, recorded

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")


def noisy(values: np.ndarray, seed: int = 1) -> np.ndarray:  # type: ignore[type-arg]
    return values + np.random.default_rng(seed).normal(0, 3e-9, len(values))


def test_a_wide_loop_that_is_only_lag_is_called_lag():
    drive = decaying(15, per_unit=20)
    model = fit([recording(drive, noisy(first_order_lag(1e-6 * drive, 0.016, RATE_Hz)))])["x"]
    assert not model.verdict.applies
    assert "phase lag, not hysteresis" in model.verdict.reason
    assert "16.0 ms" in model.verdict.reason


def test_hysteresis_behind_the_same_lag_is_not_called_lag():
    drive = decaying(15, per_unit=20)
    plays = play_sum(drive, np.array([0.0, 1, 2.5]), np.array([1.0, 0.2, 0.15]), np.zeros(3))
    model = fit([recording(drive, noisy(first_order_lag(1e-6 * plays, 0.016, RATE_Hz)))])["x"]
    assert model.verdict.applies


def test_a_butterfly_loop_is_refused():
    drive = np.tile(decaying(2, per_unit=20)[:-1], 6)
    plays = play_sum(drive, np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.5, 0.3]), np.zeros(3))
    model = fit([recording(drive, noisy(1e-7 * plays**2 + 1e-8 * plays))])["x"]
    assert not model.verdict.applies
    assert "butterfly" in model.verdict.reason


@pytest.mark.parametrize(("leading", "is_refused"), [(1, False), (2, True)])
def test_loops_that_open_the_wrong_way_in_one_of_three_recordings_are_its_own_fault(
    leading, is_refused
):
    """Its readings come early, as behind a slip of the clock."""
    recordings = []
    for k in range(3):
        drive = (1.0 - 0.1 * k) * np.tile(decaying(2, per_unit=20)[:-1], 6)
        plays = play_sum(drive, np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.2, 0.1]), np.zeros(3))
        early = np.roll(plays, -10 if k < leading else 0)
        recordings.append(recording(drive, noisy(1e-6 * early), f"r{k}"))
    model = fit(recordings)["x"]
    assert ("wrong way" in model.verdict.reason) is is_refused


def test_a_loop_is_as_wide_as_its_branches_are_apart():
    drive = through([-1.0, 1.0] * 3, 100)
    plays = play_sum(drive, np.array([0.0, 0.3]), np.array([1.0, 0.5]), np.full(2, drive[0]))
    for loop in loops_of(drive, plays, 0.01)[1:]:
        middle = np.abs(loop.drive) < 0.3
        np.testing.assert_allclose(loop.opening[middle], 0.5 * 2 * 0.3, atol=0.01)
        assert loop.span == pytest.approx(2.0, abs=0.02)


def test_levels_held_one_after_another_are_no_loop():
    """Between two levels nothing was read: straight lines there cross where no branch does."""
    levels = 5.0 * np.array([0.0, 1, -0.55, -0.34, 1, 0, 0.6])
    ways = [[b - 0.08 * (b - a)] + [b] * 200 for a, b in itertools.pairwise(levels)]
    weight = np.array([1.0, 0.2, 0.2, 0.1])
    for drive, count in ((np.concatenate(ways), 0), (through(levels.tolist()), 1)):
        plays = play_sum(drive, np.arange(4.0), weight, np.zeros(4))
        found = loops_of(drive, plays - 0.04 * plays**2, 0.1)
        wide = [loop for loop in found if loop.span > 7.0]
        assert len(wide) == count
        assert all(loop.opening.min() > -1e-9 for loop in wide)


def test_a_response_made_of_something_else_is_refused():
    rng = np.random.default_rng(3)
    drive = wandering(rng, 30)
    walk = np.cumsum(rng.normal(0, 1, len(drive)))
    response = 1e-6 * drive + 4e-6 * (walk - walk.mean()) / np.ptp(walk)
    model = fit([recording(drive, response)])["x"]
    assert not model.verdict.applies
    assert "of the displacement range" in model.verdict.reason


def test_a_reading_of_something_else_is_not_called_lag():
    drive = np.tile(decaying(2, per_unit=20)[:-1], 6)
    elsewhere = np.sin(2.0 * np.pi * 0.37 / 40.0 * np.arange(len(drive)))
    verdict = fit([recording(drive, noisy(1e-6 * elsewhere))])["x"].verdict
    assert not verdict.applies
    assert "phase lag" not in verdict.reason


def reason_of(drive: np.ndarray, response_m: np.ndarray) -> str:  # type: ignore[type-arg]
    return fit([recording(drive, response_m)])["x"].verdict.reason


def test_a_sensor_that_does_not_follow_its_drive_is_said_to_and_no_shape_is_blamed():
    rng = np.random.default_rng(12)
    drive = decaying(15, per_unit=20)
    # another axis' column: a walk of its own
    walk_m = np.cumsum(rng.normal(0.0, 4e-8, len(drive)))
    # a servo: an integrator holds the sensor against a floor that walks, and its drive is told
    floor_m, held_m, servo_V = np.cumsum(rng.normal(0.0, 2e-9, 6000)), [], []
    effort_m = 0.0
    for moved_m in floor_m.tolist():
        held_m.append(effort_m + moved_m)
        effort_m -= 0.05 * held_m[-1]
        servo_V.append(1e7 * effort_m)
    noise_m = rng.normal(0.0, 1e-9, 6000)
    for told in (reason_of(drive, walk_m), reason_of(np.array(servo_V), held_m + noise_m)):
        assert "does not follow the drive" in told
        assert "a feedback that holds the sensor" in told


@pytest.mark.parametrize("law", ["duhem", "plays"])
def test_a_gain_that_changes_over_the_cycles_makes_no_lag_of_a_loop(law, tmp_path):
    turn = np.arange(4800) / 120.0
    field = -np.cos(2.0 * np.pi * turn)
    response_um = 10.0 * LAWS[law](field) * (1.0 + 0.06 * turn / turn[-1])
    noise_um = np.random.default_rng(2).normal(0.0, 0.01, 4800)
    found = fit([recorded(tmp_path, field, response_um + noise_um)])["x"]
    assert "phase lag" not in found.verdict.reason
    assert any("the sensitivity changes by +" in said for said in found.verdict.remarks)


def test_a_branch_is_as_quiet_at_its_ends_as_between():
    drive = through([0.0, -1.0, 1.0, -1.0, 0.0], 1000)
    response = play_sum(drive, np.array([0.0, 0.3]), np.array([1.0, 0.5]), np.full(2, drive[0]))
    zigzag = 0.1 * (-1.0) ** np.arange(len(drive))
    (loop,), (still,) = (loops_of(drive, y, 0.01) for y in (response + zigzag, response))
    assert len(loop.drive) == POINTS
    few = 2000 / (POINTS + 1) - 1  # samples around each point, of which pairs cancel
    np.testing.assert_allclose(loop.rise, still.rise, atol=0.1 / few)
    np.testing.assert_allclose(loop.opening, still.opening, atol=2 * 0.1 / few)
