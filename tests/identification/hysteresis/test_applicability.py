"""Data outside the model class end in a verdict with its reason instead of a poor fit."""

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


def noisy(values: np.ndarray, seed: int = 1) -> np.ndarray:
    return values + np.random.default_rng(seed).normal(0, 3e-9, len(values))


def test_a_loop_caused_by_a_lag_is_called_lag():
    drive = decaying(15, per_unit=20)
    model = fit([recording(drive, noisy(first_order_lag(1e-6 * drive, 0.016, RATE_Hz)))])["x"]
    assert not model.verdict.applies
    assert "phase lag, not hysteresis" in model.verdict.reason
    assert "16.0 ms" in model.verdict.reason
    assert model.lag.time_s == pytest.approx(0.016, rel=0.1)


def test_a_lag_of_a_curved_response_is_called_lag():
    drive = decaying(15, per_unit=20)
    lagged = first_order_lag(drive / 5.0, 0.016, RATE_Hz)
    curved = 5e-6 * (lagged + 0.12 * lagged**2 - 0.1 * lagged**3)
    assert (
        "phase lag, not hysteresis" in fit([recording(drive, noisy(curved))])["x"].verdict.reason
    )


def test_hysteresis_behind_a_lag_is_not_called_lag():
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
def test_loops_of_wrong_direction_are_tolerated_in_one_of_three_recordings_only(
    leading, is_refused
):
    """Its readings are too early, as after a clock slip."""
    recordings = []
    for k in range(3):
        drive = (1.0 - 0.1 * k) * np.tile(decaying(2, per_unit=20)[:-1], 6)
        plays = play_sum(drive, np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.2, 0.1]), np.zeros(3))
        advanced = np.roll(plays, -10 if k < leading else 0)
        recordings.append(recording(drive, noisy(1e-6 * advanced), f"r{k}"))
    model = fit(recordings)["x"]
    assert ("wrong way" in model.verdict.reason) is is_refused


def test_the_opening_of_a_loop_is_the_distance_of_its_branches():
    drive = through([-1.0, 1.0] * 3, 100)
    plays = play_sum(drive, np.array([0.0, 0.3]), np.array([1.0, 0.5]), np.full(2, drive[0]))
    for loop in loops_of(drive, plays, 0.01)[1:]:
        middle = np.abs(loop.drive) < 0.3
        np.testing.assert_allclose(loop.opening[middle], 0.5 * 2 * 0.3, atol=0.01)
        assert loop.span == pytest.approx(2.0, abs=0.02)


def test_a_sequence_of_held_levels_is_not_a_loop():
    """There are no samples between two levels, and interpolated lines would cross."""
    levels = 5.0 * np.array([0.0, 1, -0.55, -0.34, 1, 0, 0.6])
    holds = [[b - 0.08 * (b - a)] + [b] * 200 for a, b in itertools.pairwise(levels)]
    weight = np.array([1.0, 0.2, 0.2, 0.1])
    for drive, count in ((np.concatenate(holds), 0), (through(levels.tolist()), 1)):
        plays = play_sum(drive, np.arange(4.0), weight, np.zeros(4))
        loops = loops_of(drive, plays - 0.04 * plays**2, 0.1)
        wide_loops = [loop for loop in loops if loop.span > 7.0]
        assert len(wide_loops) == count
        assert all(loop.opening.min() > -1e-9 for loop in wide_loops)


def test_an_unrelated_component_is_refused():
    rng = np.random.default_rng(3)
    drive = wandering(rng, 30)
    random_walk = np.cumsum(rng.normal(0, 1, len(drive)))
    response = 1e-6 * drive + 4e-6 * (random_walk - random_walk.mean()) / np.ptp(random_walk)
    model = fit([recording(drive, response)])["x"]
    assert not model.verdict.applies
    assert "of the displacement range" in model.verdict.reason


def test_an_unrelated_reading_is_not_called_lag():
    drive = np.tile(decaying(2, per_unit=20)[:-1], 6)
    unrelated = np.sin(2.0 * np.pi * 0.37 / 40.0 * np.arange(len(drive)))
    verdict = fit([recording(drive, noisy(1e-6 * unrelated))])["x"].verdict
    assert not verdict.applies
    assert "phase lag" not in verdict.reason


def reason_of(drive: np.ndarray, response_m: np.ndarray) -> str:
    return fit([recording(drive, response_m)])["x"].verdict.reason


def test_a_sensor_that_does_not_follow_its_drive_is_named_as_the_reason():
    rng = np.random.default_rng(12)
    drive = decaying(15, per_unit=20)
    # The column of another axis: an independent random walk.
    walk_m = np.cumsum(rng.normal(0.0, 4e-8, len(drive)))
    # A servo: an integrator holds the sensor while the floor moves, and its output is recorded.
    floor_m, sensor_m, servo_V = np.cumsum(rng.normal(0.0, 2e-9, 6000)), [], []
    actuator_m = 0.0
    for disturbance_m in floor_m.tolist():
        sensor_m.append(actuator_m + disturbance_m)
        actuator_m -= 0.05 * sensor_m[-1]
        servo_V.append(1e7 * actuator_m)
    noise_m = rng.normal(0.0, 1e-9, 6000)
    for reason in (reason_of(drive, walk_m), reason_of(np.array(servo_V), sensor_m + noise_m)):
        assert "does not follow the drive" in reason
        assert "a feedback that holds the sensor" in reason


def test_a_changing_sensitivity_is_not_called_lag(tmp_path):
    cycle = np.arange(4800) / 120.0
    field = -np.cos(2.0 * np.pi * cycle)
    response_um = 10.0 * LAWS["duhem"](field) * (1.0 + 0.06 * cycle / cycle[-1])
    noise_um = np.random.default_rng(2).normal(0.0, 0.01, 4800)
    model = fit([recorded(tmp_path, field, response_um + noise_um)])["x"]
    assert "phase lag" not in model.verdict.reason
    assert any("the sensitivity changes by +" in remark for remark in model.verdict.remarks)


def test_noise_at_the_ends_of_a_branch_is_averaged_as_in_its_middle():
    drive = through([0.0, -1.0, 1.0, -1.0, 0.0], 1000)
    response = play_sum(drive, np.array([0.0, 0.3]), np.array([1.0, 0.5]), np.full(2, drive[0]))
    zigzag = 0.1 * (-1.0) ** np.arange(len(drive))
    (loop,), (smooth,) = (loops_of(drive, y, 0.01) for y in (response + zigzag, response))
    assert len(loop.drive) == POINTS
    window = 2000 / (POINTS + 1) - 1  # samples averaged for each point
    np.testing.assert_allclose(loop.rise, smooth.rise, atol=0.1 / window)
    np.testing.assert_allclose(loop.opening, smooth.opening, atol=2 * 0.1 / window)
