"""What the runtime does when a sensor, a reference or a limit is not as it should be."""

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.runtime.controller import Controller, Status
from tests.runtime.observer_design import LinearPlant, observer_parameters
from tests.runtime.runtime_parameters import WIDE, WORKED, hysteresis, tunnelling

LIMIT_V = 4.0
NOT_NUMBERS = [np.nan, np.inf, -np.inf]


def lateral(**others):
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
        **others,
    }


def started(given, measured=0.0):
    controller = Controller(given)
    controller.start(0.0, measured)
    return controller


@pytest.mark.parametrize("bad", NOT_NUMBERS)
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_a_reference_that_is_no_number_is_replaced_by_the_last(bad, method):
    one, two = started(lateral(method=method)), started(lateral(method=method))
    first = one.run(np.array([0.5, bad, 0.7]), np.zeros(3))
    second = two.run(np.array([0.5, 0.5, 0.7]), np.zeros(3))
    assert np.array_equal(first.voltage_V, second.voltage_V)
    assert first.status[1] & Status.BAD_REFERENCE
    assert not first.status[2] & Status.BAD_REFERENCE


@pytest.mark.parametrize("bad", NOT_NUMBERS)
def test_without_a_measurement_the_loop_goes_on_by_its_model(bad):
    """A perfect plant does not notice that the sensor was away."""
    reference = np.sin(np.linspace(0, 6, 400))
    paths = []
    for lost in (False, True):
        controller, plant, path = started(lateral(method="dob")), LinearPlant(), []
        for k, wanted in enumerate(reference):
            path.append(plant.measure())
            seen = bad if lost and 100 <= k < 200 else path[-1]
            plant.drive(controller.step(wanted, seen))
        paths.append(np.array(path))
    assert np.abs(paths[0] - paths[1]).max() < 1e-12
    assert controller.status_ever & Status.BAD_MEASUREMENT


def test_a_stuck_sensor_is_said_and_no_longer_believed():
    given = lateral(method="dob", stuck_samples=50, stuck_voltage_V=0.1)
    trusting, watching = started({**given, "stuck_samples": 0}), started(given)
    reference = np.sin(np.linspace(0, 30, 3000))
    stuck = np.full(3000, 0.01)
    assert np.abs(trusting.run(reference, stuck).voltage_V).max() == LIMIT_V
    run = watching.run(reference, stuck)
    assert run.status[100:].astype(bool).all()
    assert set(run.status[200:]) == {int(Status.STUCK_SENSOR)}
    assert np.abs(run.voltage_V).max() < 2.0


@pytest.mark.parametrize("volts", [0.0, 2.0, -2.0])
def test_a_quiet_stage_is_not_a_stuck_sensor_wherever_it_rests(volts):
    controller = Controller(lateral(stuck_samples=50, stuck_voltage_V=0.1))
    controller.start(volts, 0.3)
    run = controller.run(np.full(500, 0.3), np.full(500, 0.3))
    assert run.voltage_V == pytest.approx(np.full(500, volts))
    assert not run.status.any()


def test_a_measurement_out_of_range_counts_as_the_end_of_the_range():
    one, two = started(lateral()), started(lateral())
    assert one.step(0.0, 1e300) == two.step(0.0, 6.0)
    assert one.status & Status.MEASUREMENT_LIMITED
    assert not two.status & Status.MEASUREMENT_LIMITED


def test_after_an_overflow_the_voltage_is_held_and_the_loop_starts_anew():
    """An observer that diverges is not refused: its design is not known here, its end is."""
    rest = observer_parameters()["observer_rest"]
    blind_at_rest = 1e11 * np.array([1.0, -rest[0] / rest[1], 0.0, 0.0])
    wild = lateral(
        method="dob",
        observer_L=np.full(4, 1e12),
        feedback_K_V=blind_at_rest,
        feedback_N_V_per_m=1.0,
    )
    run = started(wild).run(np.ones(2000), np.linspace(0, 1, 2000))
    anew = np.flatnonzero(run.status & Status.RESTARTED)
    assert len(anew) > 1
    assert np.diff(anew).min() > 1
    assert np.array_equal(run.voltage_V[anew], run.voltage_V[anew - 1])
    assert np.abs(run.voltage_V).max() <= LIMIT_V


def test_an_anti_windup_that_overflows_starts_anew():
    controller = Controller(
        tunnelling(rst_A0_count=2, rst_A0=np.array([1.0, 1e9]), voltage_maximum_V=1e-3)
    )
    controller.start(0.0, 1e-9)
    run = controller.run(np.full(500, 1e-8), np.full(500, 1e-9))
    anew = np.flatnonzero(run.status & Status.RESTARTED)
    assert len(anew) > 1
    assert np.diff(anew).min() > 1
    assert np.array_equal(run.voltage_V[anew], run.voltage_V[anew - 1])


def test_before_the_start_the_voltage_is_the_one_nearest_zero():
    controller = Controller(lateral(voltage_minimum_V=1.0))
    assert controller.step(0.5, 0.5) == 1.0
    assert controller.status == Status.NOT_STARTED


@pytest.mark.parametrize(
    ("low", "high"), [(5.0, 5.0), (6.0, 5.0), (np.nan, 5.0), (5.0, np.inf), (-np.inf, -5.0)]
)
def test_limits_that_hold_no_range_give_no_voltage_before_the_start(low, high):
    controller = Controller(lateral())
    controller.parameters.voltage_minimum_V = low
    controller.parameters.voltage_maximum_V = high
    assert controller.step(0.5, 0.5) == 0.0
    assert controller.status == Status.NOT_STARTED


def test_a_start_with_nothing_known_is_the_model_at_rest():
    controller = Controller(lateral())
    controller.start(np.nan, np.nan)
    assert controller.step(0.0, 0.0) == 0.0


def test_parameters_that_changed_in_memory_do_not_start():
    controller = Controller(lateral())
    controller.parameters.gain_m_per_V = 2.0
    with pytest.raises(ParameterFileError, match="checksum"):
        controller.start(0.0, 0.0)
    assert controller.step(0.1, 0.1) == 0.0
    assert controller.status == Status.NOT_STARTED


@pytest.mark.parametrize("given", [lateral(), lateral(method="dob"), tunnelling()])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_whatever_comes_in_what_goes_out_is_finite_and_inside_the_limits(given, precision, rng):
    scale = 1e-9 if given["method"] == "rst" else 1.0
    inputs = rng.normal(0, scale, (2, 20000))
    for bad in (*NOT_NUMBERS, 1e300, -1e300, 5e-324, 0.0):
        inputs[rng.integers(0, 2, 300), rng.integers(0, 20000, 300)] = bad
    controller = Controller(given, precision=precision)
    controller.start(0.0, scale)
    with np.errstate(over="ignore"):
        u = controller.run(*inputs).voltage_V
    assert (u >= given["voltage_minimum_V"]).all()
    assert (u <= given["voltage_maximum_V"]).all()
