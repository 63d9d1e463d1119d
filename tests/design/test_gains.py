"""Gains of the loop of an observer: state feedback by pole placement, and the Kalman gain."""

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.observer import disturbance_model, extended, placement
from piezoid.design.tuning import kalman_gain
from piezoid.errors import DesignError
from tests.design.placed import plant_from_fraction
from tests.design.rig import RATE_Hz, lateral_chain


@pytest.mark.parametrize(("link", "input_size"), [(0.0, 1.0), (1e-13, 1.0), (1e-7, 1e6)])
def test_a_state_that_the_input_cannot_reach_is_refused(link, input_size):
    """A state reached only at the level of rounding counts as not controllable."""
    with pytest.raises(DesignError, match="is not controllable"):
        placement(np.array([[0.5, 0.0], [link, 0.3]]), np.array([input_size, 0.0]))


@pytest.mark.parametrize("input_variance", [0.0, 1e-4])
def test_the_kalman_gain_solves_its_riccati_equation(input_variance):
    plant = plant_from_chain(lateral_chain())
    model = disturbance_model(RATE_Hz)
    gain = kalman_gain(
        plant, model, input_variance=input_variance, drift_variance=1e-3, sensor_variance=1e-2
    )
    # The reference iterates the covariance from the identity.
    A_e, C_e = extended(plant, model)
    drive = np.concatenate([plant.input_taps.sum(axis=1), [0.0]])
    Q = input_variance * np.outer(drive, drive) + np.diag([0.0, 0.0, 0.0, 0.0, 1e-3])
    P = np.eye(5)
    for _ in range(4000):
        variance = C_e @ P @ C_e + 1e-2
        L = P @ C_e / variance
        P = A_e @ (P - np.outer(L, C_e @ P)) @ A_e.T + Q
    np.testing.assert_allclose(gain, L, rtol=1e-7)


def test_an_unobservable_disturbance_has_no_observer():
    blind = plant_from_fraction(
        "blind", [0.0, 1.0, -1.0], [1.0, -0.5, 0.1], sampling_rate_Hz=RATE_Hz, output_unit="m"
    )
    with pytest.raises(DesignError, match="no stabilising solution"):
        kalman_gain(
            blind,
            disturbance_model(RATE_Hz),
            input_variance=1.0,
            drift_variance=1.0,
            sensor_variance=1.0,
        )


def test_the_rounding_of_an_instantaneous_pole_keeps_every_state():
    """A mode with a direct path and no delay; the fast pole leaves 2.8e-16 of its state."""
    A = np.array(
        [[0.9670511, 0.2536913, 0.0], [-0.2536913, 0.9567867, 0.0], [0.9500301, 0.2419992, 0.0]]
    )
    B = np.array([3.513376e-07, 2.705139e-06, 5.328345e-07])
    rounded = A.copy()
    rounded[2, 2] = 2.793248e-16
    poles = np.array([0.5, 0.4, 0.3])
    gain = placement(rounded, B)(poles)
    np.testing.assert_allclose(gain, placement(A, B)(poles), rtol=1e-6)
    placed = np.sort(np.linalg.eigvals(A - np.outer(B, gain)).real)
    np.testing.assert_allclose(placed, np.sort(poles), atol=1e-6)
