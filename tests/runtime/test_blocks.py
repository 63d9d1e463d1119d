"""Creep, filters, converter and reference limits: each alone, against its own equation."""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from tests.runtime.observer_design import observer_parameters
from tests.runtime.runtime_parameters import WIDE, WORKED, hysteresis
from tests.runtime.runtime_reference import dead_zones, follow

RATES = np.array([0.02, 0.003])
SHARES = np.array([0.015, 0.01])
# 300 Hz, numerator damping 0.2, denominator 0.8, at 20 kHz; unit gain at rest.
NOTCH = np.array([1, -1.954340001, 0.9630520957, -1.8517145433, 0.8599691522])
NOTCH = np.r_[NOTCH[:3] * (1 + NOTCH[3:].sum()) / NOTCH[:3].sum(), NOTCH[3:]]


def started(parameters, volts=0.0, measured=0.0):
    controller = Controller(parameters)
    controller.start(volts, measured)
    return controller


def static(**others):
    return {**WIDE, "method": "none", "gain_m_per_V": 0.5, **others}


def biquad(section, x):
    y = np.zeros(len(x))
    for k in range(len(x)):
        past = [(x[k - i] if k >= i else 0.0, y[k - i] if k >= i else 0.0) for i in (1, 2)]
        y[k] = section[0] * x[k] + sum(
            section[i + 1] * past[i][0] - section[i + 3] * past[i][1] for i in range(2)
        )
    return y


def test_compensated_creep_leaves_none():
    """The stage creeps by the same ladder; what it shows is what was asked for."""
    creeping = {"relaxation_count": 2, "relaxation_rate": RATES, "relaxation_share": SHARES}
    controller = started(hysteresis(WORKED, **creeping))
    reference = 2.0 * np.sign(np.sin(np.linspace(0.01, 12, 1000)))
    z, x, shown, uncrept = WORKED["z"], np.zeros(2), np.empty(1000), np.empty(1000)
    for k, wanted in enumerate(reference):
        z = follow(controller.step(wanted, 0.0), WORKED["r"], z)
        uncrept[k] = dead_zones(float(WORKED["w"] @ z), WORKED["knot"], WORKED["weight"])
        shown[k] = uncrept[k] + SHARES @ x
        x = x + RATES * (uncrept[k] - x)
    assert np.abs(shown - reference).max() < 1e-13
    assert np.abs(uncrept - reference).max() > 0.02


@pytest.mark.parametrize("place", ["reference", "command"])
def test_a_filter_is_its_difference_equation(place, rng):
    x = rng.standard_normal(300)
    given = {f"{place}_section_count": 2, f"{place}_section": np.vstack([NOTCH, NOTCH])}
    u = started(static(**given)).run(x, np.zeros(300)).voltage_V
    assert np.abs(u - biquad(NOTCH, biquad(NOTCH, x)) / 0.5).max() < 1e-12


def test_the_voltage_changes_by_no_more_than_its_step():
    controller = started(static(voltage_step_V=0.01))
    u = controller.run(np.r_[np.ones(300), -np.ones(300)], np.zeros(600)).voltage_V
    assert np.abs(np.diff(np.r_[0.0, u])).max() <= 0.01 + 1e-15
    assert Status.VOLTAGE_STEP in controller.status_ever
    assert u[250] == pytest.approx(2.0)


def test_the_reference_is_kept_in_its_range_and_to_its_step():
    given = static(reference_minimum_m=-0.2, reference_maximum_m=0.3, reference_step_m=0.1)
    run = started(given).run(np.array([1.0, 1, 1, 1, -1, -1, 0.1]), np.zeros(7))
    assert run.voltage_V * 0.5 == pytest.approx([0.1, 0.2, 0.3, 0.3, 0.2, 0.1, 0.1])
    assert list(run.status) == [Status.REFERENCE_LIMITED] * 6 + [0]


@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
@pytest.mark.parametrize(("volts", "measured"), [(0.0, 0.0), (2.0, 1.1), (-3.0, 0.4)])
def test_the_start_does_not_bump(method, volts, measured):
    given = {
        **hysteresis(WORKED, voltage_offset_V=0.5, displacement_offset_m=0.2),
        **{"relaxation_count": 2, "relaxation_rate": RATES, "relaxation_share": SHARES},
        **{"reference_section_count": 1, "reference_section": NOTCH[None, :]},
        **{"command_section_count": 1, "command_section": NOTCH[None, :]},
        **observer_parameters(1.3),
        "method": method,
    }
    assert started(given, volts, measured).step(measured, measured) == pytest.approx(
        volts, abs=1e-12
    )


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_a_stage_of_micrometres_moves_by_the_same_bits_as_one_of_metres(method, precision, rng):
    """In units of 2^-20 m every product and sum rounds alike: no number of metres is built in."""
    reference, measured = rng.normal(0, 1, (2, 200))
    volts = []
    for unit_m in (1.0, 2.0**-20):
        given = {
            **hysteresis({**WORKED, "w": unit_m * WORKED["w"], "knot": unit_m * WORKED["knot"]}),
            **{"relaxation_count": 2, "relaxation_rate": RATES, "relaxation_share": SHARES},
            **{"command_section_count": 1, "command_section": NOTCH[None, :]},
            **observer_parameters(unit_m),
            **{"displacement_offset_m": 0.25 * unit_m, "reference_step_m": 2.0 * unit_m},
            **{"reference_maximum_m": 3.0 * unit_m, "displacement_minimum_m": -2.0 * unit_m},
        }
        controller = Controller({**given, "method": method}, precision=precision)
        controller.start(0.5, unit_m * measured[0])
        volts.append(controller.run(unit_m * reference, unit_m * measured).voltage_V)
    np.testing.assert_array_equal(volts[0], volts[1])
    assert np.ptp(volts[0]) > 1.0


@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_a_stage_that_falls_as_the_drive_rises_is_the_mirrored_one(method, rng):
    given = {**hysteresis(WORKED), **observer_parameters(), "method": method}
    reference, measured = rng.normal(0, 1, (2, 200))
    rising = started({**given, "displacement_offset_m": 0.25}, 0.0, 0.25 + measured[0])
    falling = started(
        {**given, "displacement_offset_m": 0.25, "polarity": -1}, 0.0, 0.25 - measured[0]
    )
    one = rising.run(0.25 + reference, 0.25 + measured)
    two = falling.run(0.25 - reference, 0.25 - measured)
    assert np.abs(one.voltage_V - two.voltage_V).max() < 1e-11


def test_slow_creep_does_not_stand_still_in_single_precision():
    """Over 50 s at 20 kHz, 1e-6 of the rest a sample: soon below the last bit of a float."""
    slow = {"relaxation_count": 1, "relaxation_rate": [1e-6], "relaxation_share": [0.5]}
    crept = []
    for precision in ("double", "float"):
        controller = Controller(static(**slow), precision=precision)
        controller.start(0.0, 0.0)
        ones = np.ones(1_000_000)
        for _ in range(6):
            volts = controller.run(ones, ones).voltage_V[-1]
        crept.append(1.0 - 0.5 * volts)
    assert crept[0] == pytest.approx(0.5 / 1.5, rel=1e-3)
    assert crept[1] == pytest.approx(crept[0], rel=1e-5)


def test_a_reference_faster_than_the_bound_allows_is_told_and_followed():
    given = static(reference_minimum_m=-1.0, reference_maximum_m=1.0, certified_step_m=0.1)
    run = started(given).run(np.array([0.05, 0.14, 0.4, 0.4, 0.31, 0.1]), np.zeros(6))
    assert run.voltage_V * 0.5 == pytest.approx([0.05, 0.14, 0.4, 0.4, 0.31, 0.1])
    assert list(run.status) == [0, 0, Status.UNCERTIFIED, 0, 0, Status.UNCERTIFIED]
    free = started({**given, "certified_step_m": 0.0}).run(np.array([0.5]), np.zeros(1))
    assert list(free.status) == [0]
