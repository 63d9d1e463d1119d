"""Exactly at an edge: what is still allowed, and the sample at which something begins."""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.schema import MAX_ORDER
from tests.runtime.runtime_parameters import tunnelling
from tests.runtime.test_blocks import started, static
from tests.runtime.test_faults import lateral
from tests.runtime.test_schema import LATERAL, refused

ONE_VOLT = {"voltage_minimum_V": -1.0, "voltage_maximum_V": 1.0}


def section(*numbers):
    return {"reference_section_count": 1, "reference_section": [numbers]}


@pytest.mark.parametrize(
    ("given", "name"),
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
def test_lateral_parameters_are_usable_up_to_the_edge(given, name):
    assert refused({**LATERAL, **given}) == name


@pytest.mark.parametrize(
    ("given", "name"),
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
def test_tunnelling_parameters_are_usable_up_to_the_edge(given, name):
    assert refused({**tunnelling(), **given}) == name


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
    assert refused({**LATERAL, **section(*numbers)}) == (None if usable else "reference_section")


def test_a_code_on_a_limit_is_put_out_and_half_codes_go_away_from_zero():
    controller = started(static(lsb_V=0.25, **ONE_VOLT))
    volts = np.array([1.0, -1.0, 0.9, -0.9, 0.125, -0.125, 0.375, -0.375, 0.1, -0.1])
    put_out = [1.0, -1.0, 1.0, -1.0, 0.25, -0.25, 0.5, -0.5, 0.0, 0.0]
    run = controller.run(0.5 * volts, np.zeros(len(volts)))
    np.testing.assert_array_equal(run.voltage_V, put_out)
    assert not run.status.any()


def test_a_code_beyond_a_limit_between_two_codes_is_the_last_inside():
    limits = {"voltage_minimum_V": -0.9, "voltage_maximum_V": 0.9}
    run = started(static(lsb_V=0.25, **limits)).run(np.array([1.0, -1.0]), np.zeros(2))
    np.testing.assert_array_equal(run.voltage_V, [0.75, -0.75])
    assert (run.status == Status.VOLTAGE_LIMITED).all()


def steps_of_a_quarter(**others):
    """A loop whose voltage moves by exactly 0.25 V a sample, upward."""
    return lateral(method="dob", voltage_step_V=0.25, lsb_V=0.25, **others)


@pytest.mark.parametrize(
    ("samples", "volts", "first"), [(1, 0.25, 1), (3, 0.25, 2), (6, 0.25, 5), (2, 0.5, 2)]
)
def test_a_sensor_is_stuck_from_the_sample_at_which_both_conditions_hold(samples, volts, first):
    controller = started(steps_of_a_quarter(stuck_samples=samples, stuck_voltage_V=volts))
    run = controller.run(np.full(10, 2.9), np.zeros(10))
    assert np.diff(run.voltage_V[:3]).tolist() == [0.25, 0.25]
    stuck = (run.status & Status.STUCK_SENSOR) != 0
    np.testing.assert_array_equal(stuck, np.arange(10) >= first)


@pytest.mark.parametrize("change", [0.01, -0.01])
def test_any_change_lets_the_count_begin_anew(change):
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
def test_a_current_is_judged_at_the_floor_and_at_the_ceiling(current_A, status):
    controller = Controller(tunnelling())
    controller.start(0.0, 1e-9)
    controller.step(1e-9, current_A)
    assert controller.status == status


def observer_of(states, **others):
    """So many states, each of its own pole."""
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
        **others,
    }


@pytest.mark.parametrize("states", [1, MAX_ORDER])
@pytest.mark.parametrize("precision", ["double", "float"])
def test_an_observer_of_least_and_of_full_order_is_usable_and_its_last_state_counts(
    states, precision
):
    known = observer_of(states)
    assert refused(known, precision) is None
    for name, blamed in (
        ("observer_B", "observer_rest"),
        ("observer_C", "observer_C"),
        ("feedback_K_V", "feedback_N_V_per_m"),
    ):
        other = known[name].copy()
        other[-1] += 0.01
        assert refused({**known, name: other}, precision) == blamed


def test_an_observer_of_full_order_runs_as_its_equations(rng):
    given = observer_of(MAX_ORDER, observer_L=rng.normal(0, 0.1, MAX_ORDER), relaxation_count=0)
    controller = started({**given, "method": "dob"})
    A, B, C, L = (given[f"observer_{name}"] for name in "ABCL")
    x, d = np.zeros(MAX_ORDER), 0.0
    for wanted, measured in rng.normal(0, 1, (100, 2)):
        innovation = measured - C @ x
        x, d = x + L * innovation, d + 0.1 * innovation
        volts = given["feedback_N_V_per_m"] * wanted - given["feedback_K_V"] @ x - d
        assert controller.step(wanted, measured) == pytest.approx(volts, abs=1e-9)
        x = A @ x + B * (volts + d)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_states_that_nothing_moves_at_rest_are_usable(precision):
    """An oscillator among the states: it gets nothing from the voltage and is 0 at rest."""
    turn = np.array([[0.8, 0.6], [-0.6, 0.8]])
    known = observer_of(3)
    known["observer_A"][1:, 1:] = turn
    for name in ("observer_B", "observer_C", "observer_rest"):
        known[name] = np.array([known[name][0], 0.0, 0.0])
    known["observer_C"][0] = 1.0
    known["feedback_K_V"] = np.array([0.01, 1.0, 0.0])
    known["feedback_N_V_per_m"] = 1.01
    assert refused(known, precision) is None


@pytest.mark.parametrize(("current_A", "is_stuck"), [(1e-11, False), (1.001e-11, True)])
def test_a_current_that_rests_on_the_floor_is_no_stuck_sensor(current_A, is_stuck):
    """The amplifier of a lost tip reads one number for as long as nothing flows."""
    watch = {"stuck_samples": 3, "stuck_voltage_V": 1e-6, "stuck_current_A": 1e-11}
    controller = Controller(tunnelling(**watch))
    controller.start(0.0, 1e-9)
    run = controller.run(np.full(20, 1e-9), np.full(20, current_A))
    assert np.ptp(run.voltage_V) > 1e-6
    assert ((run.status & Status.STUCK_SENSOR) != 0).any() == is_stuck


@pytest.mark.parametrize("shapes", [((3,), (4,)), ((2, 2), (2, 2)), ((), ()), ((4,), (2, 2))])
def test_references_and_measurements_come_in_pairs(shapes):
    controller = started(static())
    with pytest.raises(ValueError, match="differ"):
        controller.run(*(np.zeros(shape) for shape in shapes))
