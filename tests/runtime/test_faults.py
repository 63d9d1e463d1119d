"""Answers of the runtime to faults of a sensor, a reference or a limit, and to a lost sensor."""

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.runtime.controller import Controller, Status
from tests.runtime.observer_design import LinearPlant, observer_parameters
from tests.runtime.runtime_parameters import WIDE, WORKED, hysteresis, started, tunnelling

LIMIT_V = 4.0
NOT_NUMBERS = [np.nan, np.inf, -np.inf]


def lateral(**overrides):
    return {
        **hysteresis(WORKED),
        **observer_parameters(),
        **WIDE,
        "method": "mpi_dob",
        "voltage_minimum_V": -LIMIT_V,
        "voltage_maximum_V": LIMIT_V,
        "reference_minimum_m": -3.0,
        "reference_maximum_m": 3.0,
        "displacement_minimum_m": -6.0,
        "displacement_maximum_m": 6.0,
        **overrides,
    }


@pytest.mark.parametrize("bad", NOT_NUMBERS)
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_an_invalid_reference_is_replaced_by_the_previous_one(bad, method):
    controller, reference_controller = (
        started(lateral(method=method)),
        started(lateral(method=method)),
    )
    run = controller.run(np.array([0.5, bad, 0.7]), np.zeros(3))
    expected = reference_controller.run(np.array([0.5, 0.5, 0.7]), np.zeros(3))
    assert np.array_equal(run.voltage_V, expected.voltage_V)
    assert run.status[1] & Status.BAD_REFERENCE
    assert not run.status[2] & Status.BAD_REFERENCE


@pytest.mark.parametrize("bad", NOT_NUMBERS)
def test_without_a_measurement_the_loop_follows_its_model(bad):
    """On a perfect plant, a gap in the readings changes nothing."""
    reference = np.sin(np.linspace(0, 6, 400))
    paths = []
    for has_gap in (False, True):
        controller, plant, path = started(lateral(method="dob")), LinearPlant(), []
        for k, reference_m in enumerate(reference):
            path.append(plant.measure())
            reading = bad if has_gap and 100 <= k < 200 else path[-1]
            plant.drive(controller.step(reference_m, reading))
        paths.append(np.array(path))
    assert np.abs(paths[0] - paths[1]).max() < 1e-12
    assert controller.status_ever & Status.BAD_MEASUREMENT


def test_a_stuck_sensor_is_reported_and_ignored():
    parameters = lateral(method="dob", stuck_samples=50, stuck_voltage_V=0.1)
    unwatched, watched = started({**parameters, "stuck_samples": 0}), started(parameters)
    reference = np.sin(np.linspace(0, 30, 3000))
    stuck = np.full(3000, 0.01)
    assert np.abs(unwatched.run(reference, stuck).voltage_V).max() == LIMIT_V
    run = watched.run(reference, stuck)
    assert run.status[100:].astype(bool).all()
    assert set(run.status[200:]) == {int(Status.STUCK_SENSOR)}
    assert np.abs(run.voltage_V).max() < 2.0


@pytest.mark.parametrize("volts", [0.0, 2.0, -2.0])
def test_a_stage_at_rest_is_not_a_stuck_sensor(volts):
    controller = started(lateral(stuck_samples=50, stuck_voltage_V=0.1), volts, 0.3)
    run = controller.run(np.full(500, 0.3), np.full(500, 0.3))
    assert run.voltage_V == pytest.approx(np.full(500, volts))
    assert not run.status.any()


def test_a_measurement_out_of_range_is_limited_to_the_range():
    beyond, at_end = started(lateral()), started(lateral())
    assert beyond.step(0.0, 1e300) == at_end.step(0.0, 6.0)
    assert beyond.status & Status.MEASUREMENT_LIMITED
    assert not at_end.status & Status.MEASUREMENT_LIMITED


def test_after_an_overflow_the_voltage_is_held_and_the_loop_restarts():
    """The runtime accepts a diverging observer and limits the consequences."""
    rest_states = observer_parameters()["observer_rest"]
    feedback = 1e11 * np.array([1.0, -rest_states[0] / rest_states[1], 0.0, 0.0])
    parameters = lateral(
        method="dob",
        observer_L=np.full(4, 1e12),
        feedback_K_V=feedback,
        feedback_N_V_per_m=1.0,
    )
    run = started(parameters).run(np.ones(2000), np.linspace(0, 1, 2000))
    assert_holds_at_restarts(run)
    assert np.abs(run.voltage_V).max() <= LIMIT_V
    parameters = tunnelling(rst_A0_count=2, rst_A0=[1.0, 1e9], voltage_maximum_V=1e-3)
    controller = started(parameters, measured=1e-9)
    assert_holds_at_restarts(controller.run(np.full(500, 1e-8), np.full(500, 1e-9)))


def assert_holds_at_restarts(run):
    restarts = np.flatnonzero(run.status & Status.RESTARTED)
    assert len(restarts) > 1
    assert np.diff(restarts).min() > 1
    assert np.array_equal(run.voltage_V[restarts], run.voltage_V[restarts - 1])


def test_a_controller_without_start_or_without_reading_is_at_rest():
    controller = Controller(lateral(voltage_minimum_V=1.0))
    assert controller.step(0.5, 0.5) == 1.0
    assert controller.status == Status.NOT_STARTED
    assert started(lateral(), np.nan, np.nan).step(0.0, 0.0) == 0.0


@pytest.mark.parametrize(
    ("low", "high"), [(5.0, 5.0), (6.0, 5.0), (np.nan, 5.0), (5.0, np.inf), (-np.inf, -5.0)]
)
def test_invalid_limits_give_zero_volts_before_the_start(low, high):
    controller = Controller(lateral())
    controller.parameters.voltage_minimum_V = low
    controller.parameters.voltage_maximum_V = high
    assert controller.step(0.5, 0.5) == 0.0
    assert controller.status == Status.NOT_STARTED


def test_parameters_changed_in_memory_are_refused_at_the_start():
    controller = Controller(lateral())
    controller.parameters.gain_m_per_V = 2.0
    with pytest.raises(ParameterFileError, match="checksum"):
        controller.start(0.0, 0.0)
    assert controller.step(0.1, 0.1) == 0.0
    assert controller.status == Status.NOT_STARTED


@pytest.mark.parametrize("parameters", [lateral(), lateral(method="dob"), tunnelling()])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_any_input_gives_a_finite_voltage_inside_the_limits(parameters, precision, rng):
    scale = 1e-9 if parameters["method"] == "rst" else 1.0
    inputs = rng.normal(0, scale, (2, 20000))
    for value in (*NOT_NUMBERS, 1e300, -1e300, 5e-324, 0.0):
        inputs[rng.integers(0, 2, 300), rng.integers(0, 20000, 300)] = value
    controller = started(parameters, measured=scale, precision=precision)
    with np.errstate(over="ignore"):
        u = controller.run(*inputs).voltage_V
    assert (u >= parameters["voltage_minimum_V"]).all()
    assert (u <= parameters["voltage_maximum_V"]).all()


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
