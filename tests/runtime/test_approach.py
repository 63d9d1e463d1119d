"""A tip without current: a slow approach, a bumpless hand-over, retracts that latch, a reset."""

import math

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from tests.runtime.runtime_parameters import tunnelling

SET_A = 1e-9
STEP_V = 1e-3
GUARDED = {
    "approach_step_V": STEP_V,
    "approach_log_step": 0.1,
    "contact_log": 0.7,
    "contact_samples": 3,
    "retract_samples": 5,
    "retract_step_V": 0.5,
    "search_voltage_V": 0.02,
    "trip_limit": 3,
    "trip_samples": 1000,
}


def started(volts=0.0, current_A=SET_A, precision="double", **others):
    controller = Controller(tunnelling(**{**GUARDED, **others}), precision=precision)
    controller.start(volts, current_A)
    return controller


def shown(controller, currents_A):
    currents_A = np.asarray(currents_A, float)
    return controller.run(np.full(len(currents_A), SET_A), currents_A)


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("current_A", [1e-14, 0.0, -1e-12, 3e-11, 0.2e-9])
def test_no_reading_far_below_the_set_point_makes_the_tip_faster(current_A, precision):
    """Neither floor nor an amplifier's offset: the loop integrates none of it."""
    run = shown(started(current_A=1e-12, precision=precision), np.full(300, current_A))
    assert np.diff(run.voltage_V) == pytest.approx(np.full(299, STEP_V), rel=1e-3)
    assert (run.status & Status.APPROACHING).all()


def test_a_gain_that_is_scheduled_twice_as_large_halves_the_approach():
    controller = started(current_A=1e-12)
    controller.schedule(2.0)
    run = shown(controller, np.full(10, 1e-12))
    assert np.diff(run.voltage_V) == pytest.approx(np.full(9, STEP_V / 2))


def test_the_loop_takes_over_at_rest_and_its_reference_climbs():
    """From -0.6 nepers the reference rises by 0.1 in a sample, and then stays."""
    controller, steady = started(volts=1.0, current_A=1e-12), 0.6
    before = shown(controller, np.full(20, 1e-12)).voltage_V[-1]
    run = shown(controller, np.full(12, SET_A * math.exp(-steady)))
    climbing = np.minimum(0.1 * np.arange(1, 13), steady)
    same = Controller(tunnelling(**{**GUARDED, "contact_log": 50.0}))
    same.start(before, SET_A)
    wanted = same.run(SET_A * np.exp(climbing), np.full(12, SET_A)).voltage_V
    assert np.abs(run.voltage_V - wanted).max() < 1e-12
    assert not run.status.any()


def test_a_current_that_falls_by_more_than_twice_the_contact_is_lost():
    controller = started()
    assert not shown(controller, [SET_A * math.exp(-1.39)]).status.any()
    assert shown(controller, [SET_A * math.exp(-1.41)]).status[0] == Status.APPROACHING


def test_a_lost_surface_is_searched_no_farther_than_allowed_and_three_times():
    controller = started()
    shown(controller, np.full(10, SET_A))
    run = shown(controller, np.full(2000, 1e-12))
    assert run.voltage_V.max() < 0.02 + 2 * STEP_V
    latched = np.flatnonzero(run.status & Status.LATCHED)
    assert len(latched) > 0
    assert (np.diff(latched) == 1).all()
    assert latched[-1] == 1999
    asked = Status.LATCHED | Status.NO_CURRENT | Status.RETRACTED | Status.CURRENT_LOST
    assert set(run.status[latched]) == {int(asked)}
    assert set(run.voltage_V[latched]) == {-9.0}


def test_before_the_surface_was_found_the_search_reaches_to_the_drives_end():
    controller = started(volts=-1.0, current_A=0.0, voltage_maximum_V=0.5)
    run = shown(controller, np.zeros(2000))
    assert run.voltage_V.max() == 0.5
    assert run.status[-1] & Status.LATCHED
    assert run.status[-1] & Status.NO_CURRENT
    assert run.voltage_V[-1] == -9.0


def test_one_current_among_the_noise_is_no_contact():
    controller = started(volts=-1.0, current_A=0.0)
    run = shown(controller, np.r_[np.zeros(10), SET_A, SET_A, np.zeros(100)])
    assert not (run.status & Status.RETRACTED).any()
    assert run.voltage_V[-1] > -1.0 + 100 * STEP_V


def test_a_latched_tip_waits_for_the_operator_and_then_approaches_from_there():
    controller = started()
    shown(controller, np.full(40, 1e-7))
    assert controller.status & Status.LATCHED
    waited = shown(controller, np.full(3000, 1e-12))
    assert set(waited.voltage_V) == {-9.0}
    assert (waited.status & Status.MEASUREMENT_LIMITED).all()
    controller.reset()
    run = shown(controller, np.full(500, 1e-12))
    assert run.voltage_V == pytest.approx(-9.0 + STEP_V * np.arange(1, 501))
    assert set(run.status) == {int(Status.APPROACHING | Status.CURRENT_LOST)}


def test_retracts_that_are_far_apart_do_not_latch():
    controller = started(trip_samples=50)
    for _ in range(6):
        shown(controller, np.r_[1e-7, np.full(60, SET_A)])
    assert not controller.status_ever & Status.LATCHED
    for _ in range(3):
        shown(controller, np.r_[1e-7, np.full(20, SET_A)])
    assert controller.status & Status.LATCHED


def test_a_retract_goes_one_step_back_and_never_forwards():
    controller = started(volts=-8.8)
    assert shown(controller, [1e-7]).voltage_V[0] == -9.0
    controller = started(volts=1.0)
    assert shown(controller, [1e-7]).voltage_V[0] == 0.5
    controller = started(volts=-9.5)
    assert shown(controller, [1e-7]).voltage_V[0] == -10.0


@pytest.mark.parametrize(
    ("current_A", "cause"),
    [
        (np.nan, Status.BAD_MEASUREMENT),
        (-SET_A, Status.WRONG_SIGN),
        (1e-7, Status.MEASUREMENT_LIMITED),
        (0.9 * SET_A, Status.STUCK_SENSOR),
    ],
)
def test_a_fault_that_stays_latches_and_the_status_says_which(current_A, cause):
    controller = started(stuck_samples=20, stuck_voltage_V=1e-3, stuck_current_A=-1.0)
    shown(controller, np.full(5, SET_A))
    run = shown(controller, np.full(3000, current_A))
    assert run.voltage_V.max() < 25 * STEP_V
    assert run.status[-1] & ~Status.STUCK_SENSOR == (
        Status.LATCHED | Status.RETRACTED | cause & ~Status.STUCK_SENSOR
    )
    assert run.status[-1] & cause
    later = shown(controller, np.full(100, SET_A))
    assert (later.status & cause).all()


def test_a_reading_that_repeats_itself_extends_no_faster_than_an_approach():
    watched = started(stuck_samples=1000, stuck_voltage_V=10.0, approach_step_V=1e-5)
    run = shown(watched, np.full(30, SET_A * math.exp(-0.69)))
    assert np.diff(run.voltage_V[:2])[0] > 1e-5
    assert np.diff(run.voltage_V[3:]).max() <= 1e-5 * (1 + 1e-9)


def test_a_moment_of_bad_readings_is_waited_for_without_moving():
    controller = started(volts=-1.0, current_A=1e-12)
    reached = shown(controller, np.full(10, 1e-12)).voltage_V[-1]
    run = shown(controller, np.full(5, np.nan))
    assert set(run.voltage_V) == {reached}
    assert shown(controller, [1e-12]).voltage_V[0] == pytest.approx(reached + STEP_V)


def test_a_tip_that_fled_from_a_step_up_searches_where_the_surface_was():
    """The loop flees by millivolts in a sample from readings that are late: that is no contact."""
    controller = started(volts=1.0, approach_step_V=1e-5)
    shown(controller, np.full(10, SET_A))
    fled = shown(controller, np.full(10, 10 * SET_A)).voltage_V[-1]
    run = shown(controller, np.full(5000, 1e-12))
    assert fled < 1.0 - 5e-3
    assert run.voltage_V.max() == pytest.approx(1.02, abs=2e-4)
