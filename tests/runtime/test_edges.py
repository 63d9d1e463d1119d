"""Values exactly at a limit, and the sample at which a condition begins."""

import numpy as np
import pytest

from piezoid.runtime.controller import Status
from piezoid.runtime.schema import MAX_ORDER
from tests.runtime.runtime_parameters import started, tunnelling
from tests.runtime.test_blocks import static
from tests.runtime.test_faults import lateral
from tests.runtime.test_schema import LATERAL, refused_name

ONE_VOLT = {"voltage_minimum_V": -1.0, "voltage_maximum_V": 1.0}


def section(*numbers):
    return {"reference_section_count": 1, "reference_section": [numbers]}


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ({**ONE_VOLT, "lsb_V": 1.0}, None),
        ({**ONE_VOLT, "lsb_V": 1.001}, "lsb_V"),
        ({**ONE_VOLT, "lsb_V": 2.0**-23}, None),
        ({"voltage_minimum_V": -2.0, "voltage_maximum_V": 1.0, "lsb_V": 2.0**-23}, "lsb_V"),
        ({"voltage_minimum_V": -1.0, "voltage_maximum_V": 2.0, "lsb_V": 2.0**-23}, "lsb_V"),
        ({"play_memory_V": [0, 1, 2, 3]}, None),
        ({"play_memory_V": [0, -1, -2, -3]}, None),
        ({"play_memory_V": [0, 0, -1.001, 0]}, "play_memory_V"),
        ({"play_threshold_V": [0.001, 1, 2, 3]}, "play_threshold_V"),
        ({"play_weight_m_per_V": [0.5, -0.5, 1, 1]}, "play_weight_m_per_V"),
        ({"knot_m": [-2, -1, 0, 1, 1]}, "knot_m"),
        ({"knot_m": [1, 2, 3, 4, 5]}, "knot_m"),
        ({"knot_m": [-5, -4, -3, -2, -1]}, "knot_m"),
        ({"knot_weight": [-0.8, -0.2, 1, 0, 0]}, "knot_weight"),
        ({"knot_weight": [0, 0, 1, -0.2, -0.8]}, "knot_weight"),
        ({"knot_weight": [-0.7, -0.2, 1, -0.2, -0.7]}, None),
    ],
)
def test_lateral_parameters_are_accepted_up_to_their_limits(overrides, name):
    assert refused_name({**LATERAL, **overrides}) == name


@pytest.mark.parametrize(
    ("overrides", "name"),
    [
        ({"retract_voltage_V": -10.0}, None),
        ({"retract_voltage_V": 10.0}, None),
        ({"retract_voltage_V": 10.5}, "retract_voltage_V"),
        ({"current_reference_A": 1e-11}, None),
        ({"retract_samples": 1}, None),
        ({"current_floor_A": 2.0**-39, "current_ceiling_A": 1.0}, None),
        ({"current_floor_A": 2.0**-40, "current_ceiling_A": 1.0}, "current_ceiling_A"),
        ({"rst_S": [0.5, 0.1]}, "rst_S"),
        ({"rst_A0": [0.5]}, "rst_A0"),
        ({"contact_samples": 0}, "contact_samples"),
        ({"approach_step_V": 0.0}, "approach_step_V"),
        ({"approach_log_step": 0.0}, "approach_log_step"),
        ({"contact_log": 0.0}, "contact_log"),
        ({"trip_limit": 0, "search_voltage_V": 0.0, "retract_step_V": 0.0}, None),
    ],
)
def test_tunnelling_parameters_are_accepted_up_to_their_limits(overrides, name):
    assert refused_name({**tunnelling(), **overrides}) == name


@pytest.mark.parametrize(
    ("numbers", "usable"),
    [
        ((0.3, 0, 0, -1.5, 0.8), True),
        ((-0.05, 0, 0, -1.9, 0.85), False),  # a real pole above 1
        ((3.75, 0, 0, 1.9, 0.85), False),  # and one below -1
        ((3.0, 0, 0, 1.5, 0.5), False),  # a pole at -1
        ((0.0, 0, 0, -1.5, 0.5), False),  # a pole at 1
        ((2.0, 0, 0, 0, 1.0), False),  # a pair on the circle
        ((0.2, 0, 0, -1.9, 1.1), False),  # and one outside
        ((0.1, 0.1, 0.1, -1.5, 0.8), True),
        ((0.1, 0.1, 0.101, -1.5, 0.8), False),  # another gain at rest
    ],
)
def test_sections_are_stable_and_of_unit_gain(numbers, usable):
    assert refused_name({**LATERAL, **section(*numbers)}) == (
        None if usable else "reference_section"
    )


def test_codes_reach_the_limits_and_half_codes_round_away_from_zero():
    controller = started(static(lsb_V=0.25, **ONE_VOLT))
    volts = np.array([1.0, -1.0, 0.9, -0.9, 0.125, -0.125, 0.375, -0.375, 0.1, -0.1])
    outputs = [1.0, -1.0, 1.0, -1.0, 0.25, -0.25, 0.5, -0.5, 0.0, 0.0]
    run = controller.run(0.5 * volts, np.zeros(len(volts)))
    np.testing.assert_array_equal(run.voltage_V, outputs)
    assert not run.status.any()
    limits = {"voltage_minimum_V": -0.9, "voltage_maximum_V": 0.9}
    run = started(static(lsb_V=0.25, **limits)).run(np.array([1.0, -1.0]), np.zeros(2))
    np.testing.assert_array_equal(run.voltage_V, [0.75, -0.75])
    assert (run.status == Status.VOLTAGE_LIMITED).all()


def steps_of_a_quarter(**overrides):
    """Return a loop whose voltage rises by exactly 0.25 V per sample."""
    return lateral(method="dob", voltage_step_V=0.25, lsb_V=0.25, **overrides)


@pytest.mark.parametrize(
    ("samples", "volts", "first"), [(1, 0.25, 1), (3, 0.25, 2), (6, 0.25, 5), (2, 0.5, 2)]
)
def test_a_sensor_is_stuck_once_both_conditions_hold(samples, volts, first):
    controller = started(steps_of_a_quarter(stuck_samples=samples, stuck_voltage_V=volts))
    run = controller.run(np.full(10, 2.9), np.zeros(10))
    assert np.diff(run.voltage_V[:3]).tolist() == [0.25, 0.25]
    stuck = (run.status & Status.STUCK_SENSOR) != 0
    np.testing.assert_array_equal(stuck, np.arange(10) >= first)


@pytest.mark.parametrize("change", [0.01, -0.01])
def test_any_change_restarts_the_count_of_equal_readings(change):
    controller = started(steps_of_a_quarter(stuck_samples=3, stuck_voltage_V=0.25))
    measured = np.where(np.arange(10) < 5, 0.0, change)
    run = controller.run(np.full(10, 2.9), measured)
    stuck = (run.status & Status.STUCK_SENSOR) != 0
    np.testing.assert_array_equal(np.flatnonzero(stuck), [2, 3, 4, 8, 9])


@pytest.mark.parametrize(
    ("current_A", "status"),
    [
        (1e-11, Status.APPROACHING),
        (0.999e-11, Status.CURRENT_LOST | Status.APPROACHING),
        (1.999e-8, 0),
        (2e-8, Status.MEASUREMENT_LIMITED | Status.RETRACTED),
    ],
)
def test_a_current_is_compared_with_its_floor_and_ceiling(current_A, status):
    controller = started(tunnelling(), measured=1e-9)
    controller.step(1e-9, current_A)
    assert controller.status == status


def observer_of(states, **overrides):
    """Return an observer with ``states`` states and distinct poles."""
    pole = np.linspace(0.1, 0.9, states)
    return {
        **LATERAL,
        "gain_m_per_V": 1.0,
        "observer_order": states,
        "observer_A": np.diag(pole),
        "observer_B": 1.0 - pole,
        "observer_C": np.full(states, 1.0 / states),
        "observer_L": np.zeros(states),
        "observer_disturbance_L_V_per_m": 0.1,
        "observer_rest": np.ones(states),
        "feedback_K_V": np.full(states, 0.01),
        "feedback_N_V_per_m": 1.0 + 0.01 * states,
        **overrides,
    }


@pytest.mark.parametrize("states", [1, MAX_ORDER])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_last_state_of_an_observer_of_any_order_is_checked(states, precision):
    parameters = observer_of(states)
    assert refused_name(parameters, precision) is None
    for name, message in (
        ("observer_B", "observer_rest"),
        ("observer_C", "observer_C"),
        ("feedback_K_V", "feedback_N_V_per_m"),
    ):
        changed = parameters[name].copy()
        changed[-1] += 0.01
        assert refused_name({**parameters, name: changed}, precision) == message


def test_an_observer_of_full_order_runs_as_its_equations(rng):
    parameters = observer_of(
        MAX_ORDER, observer_L=rng.normal(0, 0.1, MAX_ORDER), relaxation_count=0
    )
    controller = started({**parameters, "method": "dob"})
    A, B, C, L = (parameters[f"observer_{name}"] for name in "ABCL")
    x, d = np.zeros(MAX_ORDER), 0.0
    for reference, measured in rng.normal(0, 1, (100, 2)):
        innovation = measured - C @ x
        x, d = x + L * innovation, d + 0.1 * innovation
        volts = parameters["feedback_N_V_per_m"] * reference - parameters["feedback_K_V"] @ x - d
        assert controller.step(reference, measured) == pytest.approx(volts, abs=1e-9)
        x = A @ x + B * (volts + d)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_states_that_are_zero_at_rest_are_accepted(precision):
    """Two states form an oscillator that the voltage does not drive."""
    rotation = np.array([[0.8, 0.6], [-0.6, 0.8]])
    parameters = observer_of(3)
    parameters["observer_A"][1:, 1:] = rotation
    for name in ("observer_B", "observer_C", "observer_rest"):
        parameters[name] = np.array([parameters[name][0], 0.0, 0.0])
    parameters["observer_C"][0] = 1.0
    parameters["feedback_K_V"] = np.array([0.01, 1.0, 0.0])
    parameters["feedback_N_V_per_m"] = 1.01
    assert refused_name(parameters, precision) is None


@pytest.mark.parametrize(("current_A", "is_stuck"), [(1e-11, False), (1.001e-11, True)])
def test_a_constant_current_at_the_floor_is_no_stuck_sensor(current_A, is_stuck):
    """The amplifier of a lost tip reads a constant as long as no current flows."""
    watch = {"stuck_samples": 3, "stuck_voltage_V": 1e-6, "stuck_current_A": 1e-11}
    run = started(tunnelling(**watch), measured=1e-9).run(
        np.full(20, 1e-9), np.full(20, current_A)
    )
    assert np.ptp(run.voltage_V) > 1e-6
    assert ((run.status & Status.STUCK_SENSOR) != 0).any() == is_stuck


@pytest.mark.parametrize("shapes", [((3,), (4,)), ((2, 2), (2, 2)), ((), ()), ((4,), (2, 2))])
def test_references_and_measurements_come_in_pairs(shapes):
    controller = started(static())
    with pytest.raises(ValueError, match="differ"):
        controller.run(*(np.zeros(shape) for shape in shapes))
