"""Lateral axes without a sensor follow the model for a limited time, then hold the voltage."""

import numpy as np
import pytest

from piezoid.runtime.controller import Status
from tests.runtime.runtime_parameters import started
from tests.runtime.test_faults import lateral

HOLD = Status.BLIND | Status.LATCHED
LIMIT = 50


def run_lateral(measured, **overrides):
    controller = started(lateral(blind_samples=LIMIT, **overrides))
    reference = np.sin(np.linspace(0, 6, len(measured)))
    voltage, status = np.empty(len(measured)), np.empty(len(measured), dtype=int)
    for k, (reference_m, reading) in enumerate(zip(reference, measured, strict=True)):
        voltage[k], status[k] = controller.step(reference_m, reading), controller.status
    return voltage, status


@pytest.mark.parametrize("method", ["dob", "mpi_dob"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.01])
def test_a_permanently_failed_sensor_ends_in_a_hold(bad, method):
    watch = {"stuck_samples": 20, "stuck_voltage_V": 0.01}
    voltage, status = run_lateral(np.full(400, bad), method=method, **watch)
    held_samples = np.flatnonzero(status & HOLD)
    first = LIMIT - 1 if not np.isfinite(bad) else LIMIT + 20
    assert abs(held_samples[0] - first) <= 1
    assert np.array_equal(held_samples, np.arange(held_samples[0], 400))
    assert (status[held_samples] & HOLD == HOLD).all()
    assert np.ptp(voltage[held_samples[0] - 1 :]) == 0.0


def test_a_recovered_or_unused_sensor_and_a_limit_of_zero_cause_no_hold():
    measured = np.zeros(400)
    measured[100 : 100 + LIMIT - 1] = np.nan
    assert not (run_lateral(measured)[1] & HOLD).any()
    assert not run_lateral(np.full(400, np.nan), method="mpi")[1].any()
    run = started(lateral(blind_samples=0)).run(
        np.sin(np.linspace(0, 60, 5000)), np.full(5000, np.nan)
    )
    assert set(run.status) == {int(Status.BAD_MEASUREMENT)}


def test_after_a_reset_the_loop_starts_without_a_bump():
    """With the reference at the reading, the first voltage is the held voltage."""
    controller = started(lateral(method="dob", blind_samples=LIMIT))
    run = controller.run(np.full(2 * LIMIT, 0.5), np.full(2 * LIMIT, np.nan))
    controller.run(np.full(5, 0.5), np.full(5, 0.3))
    assert controller.status & HOLD == HOLD
    controller.reset()
    assert controller.step(0.3, 0.3) == pytest.approx(run.voltage_V[-1], abs=1e-12)
    assert not controller.status
