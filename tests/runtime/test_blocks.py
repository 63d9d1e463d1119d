"""Creep, filters, converter, reference limits and feedforward, each against its equation."""

import numpy as np
import pytest

from piezoid.runtime.controller import Status
from tests.runtime.observer_design import observer_parameters
from tests.runtime.runtime_parameters import CREEP, WIDE, WORKED, hysteresis, started
from tests.runtime.runtime_reference import dead_zones, follow
from tests.verification.rig import lateral_parameters

# 300 Hz, numerator damping 0.2, denominator 0.8, at 20 kHz; unit gain at rest.
NOTCH = np.array([1, -1.954340001, 0.9630520957, -1.8517145433, 0.8599691522])
NOTCH = np.r_[NOTCH[:3] * (1 + NOTCH[3:].sum()) / NOTCH[:3].sum(), NOTCH[3:]]


def static(**overrides):
    return {**WIDE, "method": "none", "gain_m_per_V": 0.5, **overrides}


def biquad(section, x):
    y = np.zeros(len(x))
    for k in range(len(x)):
        history = [(x[k - i] if k >= i else 0.0, y[k - i] if k >= i else 0.0) for i in (1, 2)]
        y[k] = section[0] * x[k] + sum(
            section[i + 1] * history[i][0] - section[i + 3] * history[i][1] for i in range(2)
        )
    return y


def test_the_controller_compensates_creep():
    """The stage creeps by the same ladder, so its displacement equals the reference."""
    rates, shares = CREEP["relaxation_rate"], CREEP["relaxation_share"]
    controller = started(hysteresis(WORKED, **CREEP))
    reference = 2.0 * np.sign(np.sin(np.linspace(0.01, 12, 1000)))
    z, x, displacement, instantaneous = WORKED["z"], np.zeros(2), np.empty(1000), np.empty(1000)
    for k, reference_m in enumerate(reference):
        z = follow(controller.step(reference_m, 0.0), WORKED["r"], z)
        instantaneous[k] = dead_zones(float(WORKED["w"] @ z), WORKED["knot"], WORKED["weight"])
        displacement[k] = instantaneous[k] + shares @ x
        x = x + rates * (instantaneous[k] - x)
    assert np.abs(displacement - reference).max() < 1e-13
    assert np.abs(instantaneous - reference).max() > 0.02


@pytest.mark.parametrize("filter_name", ["reference", "command"])
def test_a_filter_is_its_difference_equation(filter_name, rng):
    x = rng.standard_normal(300)
    filters = {
        f"{filter_name}_section_count": 2,
        f"{filter_name}_section": np.vstack([NOTCH, NOTCH]),
    }
    u = started(static(**filters)).run(x, np.zeros(300)).voltage_V
    assert np.abs(u - biquad(NOTCH, biquad(NOTCH, x)) / 0.5).max() < 1e-12


def test_voltage_and_reference_are_limited_in_range_and_step():
    controller = started(static(voltage_step_V=0.01))
    u = controller.run(np.r_[np.ones(300), -np.ones(300)], np.zeros(600)).voltage_V
    assert np.abs(np.diff(np.r_[0.0, u])).max() <= 0.01 + 1e-15
    assert Status.VOLTAGE_STEP in controller.status_ever
    assert u[250] == pytest.approx(2.0)
    parameters = static(reference_minimum_m=-0.2, reference_maximum_m=0.3, reference_step_m=0.1)
    run = started(parameters).run(np.array([1.0, 1, 1, 1, -1, -1, 0.1]), np.zeros(7))
    assert run.voltage_V * 0.5 == pytest.approx([0.1, 0.2, 0.3, 0.3, 0.2, 0.1, 0.1])
    assert list(run.status) == [Status.REFERENCE_LIMITED] * 6 + [0]


@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
@pytest.mark.parametrize(("volts", "measured"), [(0.0, 0.0), (2.0, 1.1), (-3.0, 0.4)])
def test_the_start_does_not_bump(method, volts, measured):
    parameters = {
        **hysteresis(WORKED, voltage_offset_V=0.5, displacement_offset_m=0.2),
        **CREEP,
        **{"reference_section_count": 1, "reference_section": NOTCH[None, :]},
        **{"command_section_count": 1, "command_section": NOTCH[None, :]},
        **observer_parameters(1.3),
        "method": method,
    }
    assert started(parameters, volts, measured).step(measured, measured) == pytest.approx(
        volts, abs=1e-12
    )


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_a_stage_in_micrometres_has_the_same_bits_as_in_metres(method, precision, rng):
    """In units of 2^-20 m every product and sum rounds alike, so no constant has metres."""
    reference, measured = rng.normal(0, 1, (2, 200))
    volts = []
    for unit_m in (1.0, 2.0**-20):
        parameters = {
            **hysteresis({**WORKED, "w": unit_m * WORKED["w"], "knot": unit_m * WORKED["knot"]}),
            **CREEP,
            **{"command_section_count": 1, "command_section": NOTCH[None, :]},
            **observer_parameters(unit_m),
            **{"displacement_offset_m": 0.25 * unit_m, "reference_step_m": 2.0 * unit_m},
            **{"reference_maximum_m": 3.0 * unit_m, "displacement_minimum_m": -2.0 * unit_m},
        }
        parameters["method"] = method
        controller = started(parameters, 0.5, unit_m * measured[0], precision)
        volts.append(controller.run(unit_m * reference, unit_m * measured).voltage_V)
    np.testing.assert_array_equal(volts[0], volts[1])
    assert np.ptp(volts[0]) > 1.0


@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_negative_polarity_mirrors_the_stage(method, rng):
    parameters = {**hysteresis(WORKED), **observer_parameters(), "method": method}
    reference, measured = rng.normal(0, 1, (2, 200))
    rising = started({**parameters, "displacement_offset_m": 0.25}, 0.0, 0.25 + measured[0])
    falling = started(
        {**parameters, "displacement_offset_m": 0.25, "polarity": -1}, 0.0, 0.25 - measured[0]
    )
    rising_run = rising.run(0.25 + reference, 0.25 + measured)
    falling_run = falling.run(0.25 - reference, 0.25 - measured)
    assert np.abs(rising_run.voltage_V - falling_run.voltage_V).max() < 1e-11


def test_slow_creep_in_single_precision_follows_double():
    """A change of 1e-6 of the remaining creep in each sample is soon below the last float bit."""
    ladder = {"relaxation_count": 1, "relaxation_rate": [1e-6], "relaxation_share": [0.5]}
    creep_m = []
    for precision in ("double", "float"):
        controller = started(static(**ladder), precision=precision)
        unit_steps = np.ones(1_000_000)
        for _ in range(6):
            volts = controller.run(unit_steps, unit_steps).voltage_V[-1]
        creep_m.append(1.0 - 0.5 * volts)
    assert creep_m[0] == pytest.approx(0.5 / 1.5, rel=1e-3)
    assert creep_m[1] == pytest.approx(creep_m[0], rel=1e-5)


def test_a_reference_beyond_the_certified_step_is_reported_and_followed():
    parameters = static(reference_minimum_m=-1.0, reference_maximum_m=1.0, certified_step_m=0.1)
    run = started(parameters).run(np.array([0.05, 0.14, 0.4, 0.4, 0.31, 0.1]), np.zeros(6))
    assert run.voltage_V * 0.5 == pytest.approx([0.05, 0.14, 0.4, 0.4, 0.31, 0.1])
    assert list(run.status) == [0, 0, Status.UNCERTIFIED, 0, 0, Status.UNCERTIFIED]
    uncertified = started({**parameters, "certified_step_m": 0.0}).run(
        np.array([0.5]), np.zeros(1)
    )
    assert list(uncertified.status) == [0]


def controllers(precision="double", method="mpi_dob"):
    values = lateral_parameters().for_method(method).values
    return [started(values, precision=precision) for _ in range(2)]


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_a_table_of_zero_changes_no_bit(method, precision):
    feedback, with_table = controllers(precision, method)
    rng = np.random.default_rng(0)
    references, readings = 1e-5 * rng.standard_normal((2, 500))
    readings[100:110], references[300] = np.nan, np.inf
    for reference, reading in zip(references.tolist(), readings.tolist(), strict=True):
        voltage_V, with_table_V = (
            feedback.step(reference, reading),
            with_table.step(reference, reading, 0.0),
        )
        assert (voltage_V, np.signbit(voltage_V)) == (with_table_V, np.signbit(with_table_V))
        assert feedback.status == with_table.status


def test_a_table_is_added_within_the_limits():
    feedback, with_table = controllers()
    assert with_table.step(0.0, 0.0, 0.5) == pytest.approx(feedback.step(0.0, 0.0) + 0.5, abs=2e-4)
    for value_V in (1e9, -1e300):
        assert abs(with_table.step(0.0, 0.0, value_V)) <= 10.0
        assert Status.VOLTAGE_LIMITED in with_table.status


@pytest.mark.parametrize("bad_V", [np.nan, np.inf, -np.inf])
def test_an_invalid_table_value_is_ignored_and_reported(bad_V):
    feedback, with_table = controllers()
    assert with_table.step(1e-6, 0.0, bad_V) == feedback.step(1e-6, 0.0)
    assert Status.BAD_REFERENCE in with_table.status
