"""X and Y without a sensor: the model flies on for so long, then the voltage is held."""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from tests.runtime.test_faults import lateral

HELD = Status.BLIND | Status.LATCHED
LIMIT = 50


def flown(measured, **others):
    controller = Controller(lateral(blind_samples=LIMIT, **others))
    controller.start(0.0, 0.0)
    reference = np.sin(np.linspace(0, 6, len(measured)))
    voltage, status = np.empty(len(measured)), np.empty(len(measured), dtype=int)
    for k, (wanted, seen) in enumerate(zip(reference, measured, strict=True)):
        voltage[k], status[k] = controller.step(wanted, seen), controller.status
    return voltage, status


@pytest.mark.parametrize("method", ["dob", "mpi_dob"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.01])
def test_a_sensor_that_is_gone_for_good_ends_in_a_hold(bad, method):
    watch = {"stuck_samples": 20, "stuck_voltage_V": 0.01}
    voltage, status = flown(np.full(400, bad), method=method, **watch)
    held = np.flatnonzero(status & HELD)
    first = LIMIT - 1 if not np.isfinite(bad) else LIMIT + 20
    assert abs(held[0] - first) <= 1
    assert np.array_equal(held, np.arange(held[0], 400))
    assert (status[held] & HELD == HELD).all()
    assert np.ptp(voltage[held[0] - 1 :]) == 0.0


def test_a_sensor_that_comes_back_in_time_is_no_hold():
    measured = np.zeros(400)
    measured[100 : 100 + LIMIT - 1] = np.nan
    assert not (flown(measured)[1] & HELD).any()


def test_without_feedback_nobody_looks_at_the_sensor():
    assert not flown(np.full(400, np.nan), method="mpi")[1].any()


def test_after_a_reset_the_loop_starts_from_where_the_stage_stands():
    """No bump: with the reference on what the sensor shows, the held voltage comes out again."""
    controller = Controller(lateral(method="dob", blind_samples=LIMIT))
    controller.start(0.0, 0.0)
    away = controller.run(np.full(2 * LIMIT, 0.5), np.full(2 * LIMIT, np.nan))
    controller.run(np.full(5, 0.5), np.full(5, 0.3))
    assert controller.status & HELD == HELD
    controller.reset()
    assert controller.step(0.3, 0.3) == pytest.approx(away.voltage_V[-1], abs=1e-12)
    assert not controller.status


def test_a_limit_of_zero_flies_for_ever():
    controller = Controller(lateral(blind_samples=0))
    controller.start(0.0, 0.0)
    run = controller.run(np.sin(np.linspace(0, 60, 5000)), np.full(5000, np.nan))
    assert set(run.status) == {int(Status.BAD_MEASUREMENT)}
