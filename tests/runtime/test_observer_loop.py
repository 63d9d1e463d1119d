"""The disturbance-observer loop around a stage with hysteresis and creep."""

import numpy as np
import pytest

from piezoid.runtime.controller import Status
from tests.runtime.observer_design import LinearPlant, observer_parameters
from tests.runtime.runtime_parameters import CREEP, WIDE, WORKED, hysteresis, started
from tests.runtime.runtime_reference import dead_zones, follow


def observer(**overrides):
    return {**WIDE, "method": "dob", **observer_parameters(), **overrides}


class HysteresisPlant(LinearPlant):
    """Plays, dead zones, creep of their output on request, then the linear chain."""

    def __init__(self, model, creeps=False):
        super().__init__()
        self.model, self.z = model, model["z"]
        self.crept, self.share = np.zeros(2), CREEP["relaxation_share"] * creeps

    def drive(self, volts):
        self.z = follow(volts, self.model["r"], self.z)
        h = float(self.model["w"] @ self.z)
        displacement = dead_zones(h, self.model["knot"], self.model["weight"])
        super().drive(displacement + self.share @ self.crept)
        self.crept = self.crept + CREEP["relaxation_rate"] * (displacement - self.crept)


def close_loop(controller, plant, reference):
    """Return displacement and voltage of every sample."""
    displacement, voltage = np.empty((2, len(reference)))
    for k, reference_m in enumerate(reference):
        displacement[k] = plant.measure()
        voltage[k] = controller.step(reference_m, displacement[k])
        plant.drive(voltage[k])
    return displacement, voltage


@pytest.mark.parametrize("creeps", [False, True])
def test_the_inverse_linearises_a_stage_with_hysteresis(creeps):
    """Observer and inverse on the true hysteresis move like the observer on a linear stage."""
    reference = 2.0 * np.sin(np.linspace(0, 20, 1500)) * np.linspace(0.1, 1.2, 1500)
    parameters = {**hysteresis(WORKED), **observer(), **(CREEP if creeps else {})}
    controller = started({**parameters, "method": "mpi_dob"})
    y, u = close_loop(controller, HysteresisPlant(WORKED, creeps), reference)
    linear_y, _ = close_loop(started(observer()), LinearPlant(), reference)
    assert np.abs(y - linear_y).max() < 1e-10
    assert np.abs(u - reference).max() > 0.3


@pytest.mark.parametrize("method", ["dob", "mpi_dob"])
def test_a_saturated_loop_does_not_wind_up(method):
    """After a long time at a limit of the converter, the loop settles without delay."""
    parameters = {
        **hysteresis(WORKED),
        **observer(voltage_minimum_V=-2.5, voltage_maximum_V=2.5, lsb_V=1e-6),
        "method": method,
    }
    reference = np.r_[np.full(2000, 50.0), np.full(400, 0.5)]
    plant = HysteresisPlant(WORKED) if method == "mpi_dob" else LinearPlant()
    controller = started(parameters)
    y, u = close_loop(controller, plant, reference)
    assert u.max() <= 2.5
    assert Status.VOLTAGE_LIMITED in controller.status_ever
    assert np.abs(y[2150:] - 0.5).max() < 0.02
    assert np.abs(y[2300:] - 0.5).max() < 1e-4


def test_the_observer_rejects_a_model_error():
    model = {**WORKED, "w": WORKED["w"] * np.array([1.05, 0.9, 1.1, 0.95])}
    controller = started({**hysteresis(model), **observer(), "method": "mpi_dob"})
    y, _ = close_loop(controller, HysteresisPlant(WORKED), np.full(800, 1.5))
    assert abs(y[-1] - 1.5) < 1e-9


def test_single_precision_follows_double():
    reference = 2.0 * np.sin(np.linspace(0, 20, 1500))
    parameters = {**hysteresis(WORKED), **observer(lsb_V=20 / 65536), "method": "mpi_dob"}
    runs = [
        close_loop(started(parameters, precision=p), HysteresisPlant(WORKED), reference)[0]
        for p in ("double", "float")
    ]
    # Single precision may choose another code: two codes times the steepest slope.
    assert np.abs(runs[0] - runs[1]).max() < 2 * 1.3 * 20 / 65536
