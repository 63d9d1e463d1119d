"""The disturbance-observer loop around a stage with hysteresis and creep."""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from tests.runtime.observer_design import LinearPlant, observer_parameters
from tests.runtime.runtime_parameters import WIDE, WORKED, hysteresis
from tests.runtime.runtime_reference import dead_zones, follow


def observer(**others):
    return {**WIDE, "method": "dob", **observer_parameters(), **others}


CREEP = {
    "relaxation_count": 2,
    "relaxation_rate": np.array([0.02, 0.003]),
    "relaxation_share": np.array([0.015, 0.01]),
}


class HysteresisPlant(LinearPlant):
    """Dead zones after plays, creep of what they show if asked for, then the linear chain."""

    def __init__(self, model, creeps=False):
        super().__init__()
        self.model, self.z = model, model["z"]
        self.crept, self.share = np.zeros(2), CREEP["relaxation_share"] * creeps

    def drive(self, volts):
        self.z = follow(volts, self.model["r"], self.z)
        h = float(self.model["w"] @ self.z)
        moved = dead_zones(h, self.model["knot"], self.model["weight"])
        super().drive(moved + self.share @ self.crept)
        self.crept = self.crept + CREEP["relaxation_rate"] * (moved - self.crept)


def close_loop(controller, plant, reference):
    """Displacement and voltage of every sample."""
    displacement, voltage = np.empty((2, len(reference)))
    for k, wanted in enumerate(reference):
        displacement[k] = plant.measure()
        voltage[k] = controller.step(wanted, displacement[k])
        plant.drive(voltage[k])
    return displacement, voltage


def started(parameters, **precision):
    controller = Controller(parameters, **precision)
    controller.start(0.0, 0.0)
    return controller


@pytest.mark.parametrize("creeps", [False, True])
def test_the_inverse_makes_a_stage_with_hysteresis_the_linear_one(creeps):
    """Observer and inverse on the true hysteresis move as the observer alone without it."""
    reference = 2.0 * np.sin(np.linspace(0, 20, 1500)) * np.linspace(0.1, 1.2, 1500)
    given = {**hysteresis(WORKED), **observer(), **(CREEP if creeps else {})}
    both = started({**given, "method": "mpi_dob"})
    y, u = close_loop(both, HysteresisPlant(WORKED, creeps), reference)
    linear, _ = close_loop(started(observer()), LinearPlant(), reference)
    assert np.abs(y - linear).max() < 1e-10
    assert np.abs(u - reference).max() > 0.3


@pytest.mark.parametrize("method", ["dob", "mpi_dob"])
def test_at_the_limits_nothing_winds_up(method):
    """After a long time at the converter's end the loop is as quick as ever."""
    given = {
        **hysteresis(WORKED),
        **observer(voltage_minimum_V=-2.5, voltage_maximum_V=2.5, lsb_V=1e-6),
        "method": method,
    }
    reference = np.r_[np.full(2000, 50.0), np.full(400, 0.5)]
    plant = HysteresisPlant(WORKED) if method == "mpi_dob" else LinearPlant()
    controller = started(given)
    y, u = close_loop(controller, plant, reference)
    assert u.max() <= 2.5
    assert Status.VOLTAGE_LIMITED in controller.status_ever
    assert np.abs(y[2150:] - 0.5).max() < 0.02
    assert np.abs(y[2300:] - 0.5).max() < 1e-4


def test_an_observer_that_disagrees_with_its_plant_still_removes_what_the_model_misses():
    wrong = {**WORKED, "w": WORKED["w"] * np.array([1.05, 0.9, 1.1, 0.95])}
    controller = started({**hysteresis(wrong), **observer(), "method": "mpi_dob"})
    y, _ = close_loop(controller, HysteresisPlant(WORKED), np.full(800, 1.5))
    assert abs(y[-1] - 1.5) < 1e-9


def test_float_follows_double():
    reference = 2.0 * np.sin(np.linspace(0, 20, 1500))
    given = {**hysteresis(WORKED), **observer(lsb_V=20 / 65536), "method": "mpi_dob"}
    runs = [
        close_loop(started(given, precision=p), HysteresisPlant(WORKED), reference)[0]
        for p in ("double", "float")
    ]
    # Two converter codes through the steepest slope: single precision may choose another code.
    assert np.abs(runs[0] - runs[1]).max() < 2 * 1.3 * 20 / 65536
