"""Disturbance observer: worked example, delays, published tunings, and its gains."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.observer import (
    DisturbanceObserver,
    disturbance_model,
    extended,
    linear_controller,
    placement,
)
from piezoid.design.plant import Plant, Section
from piezoid.design.rst import feedback_poles, observer_poles
from piezoid.design.sensitivity import closed_loop_polynomial, margins, sensitivities
from piezoid.design.tuning import kalman_gain
from piezoid.errors import DesignError
from piezoid.numerics.polynomial import from_roots, roots_of
from tests.design.placed import place_observer, plant_from_fraction
from tests.design.rig import RATE_Hz, lateral_chain, poles, printed_observer_poles

PRINTED = 5.1e-11
PRINTED_CLOSED_LOOP = np.concatenate(
    [
        (1, -4.5750108263, 8.9001057978, -9.5574086345, 6.1517173975),
        (-2.4126438412, 0.5616117386, -0.0724327942, 0.004516861, -0.0001052682),
    ]
)
RUNTIME_TOLERANCE = 64.0 * np.finfo(float).eps  # `near` in piezoid_runtime.c
DELAYS_s = (0.0, 20e-6, 50e-6, 120e-6)


def example(gain: float = 1.0, delay_s: float = 0.0) -> tuple[Plant, DisturbanceObserver]:
    plant = plant_from_chain(lateral_chain(gain, delay_s))
    feedback, observer = printed_observer_poles()
    return plant, place_observer(plant, feedback_poles=feedback, observer_poles=observer)


def test_the_worked_example_has_its_printed_coefficients():
    plant, observer = example()
    c = linear_controller(observer)
    np.testing.assert_allclose(
        -c.R,
        (-1.6493438444, 3.8931363194, -2.8841710805, 0.6598793035, -0.0331133718, 0),
        atol=PRINTED,
    )
    np.testing.assert_allclose(
        c.S,
        (1, -2.2838911271, 1.9549855646, -0.7903742073, 0.1247293518, -0.005449582),
        atol=PRINTED,
    )
    assert observer.reference_gain == pytest.approx(0.8496259921, abs=PRINTED)
    np.testing.assert_allclose(
        closed_loop_polynomial(plant, c.R, c.S), PRINTED_CLOSED_LOOP, atol=PRINTED
    )


@settings(max_examples=30)
@given(st.floats(-9.0, 0.0), st.floats(0.0, 8.0), st.floats(30.0, 3000.0), st.floats(30.0, 3000.0))
def test_the_static_gain_meets_the_tolerance_of_the_runtime(
    decades, delay_samples, feedback_Hz, observed_Hz
):
    with_mode = lateral_chain(10.0**decades, delay_samples / RATE_Hz)
    plant = plant_from_chain(replace(with_mode, sections=with_mode.sections[::2]))
    observer = Section(frequency_Hz=observed_Hz)
    placed = place_observer(
        plant,
        feedback_poles=feedback_poles(plant, Section(frequency_Hz=feedback_Hz)),
        observer_poles=observer_poles(plant, observer, observed_Hz, ()),
    )
    states = np.linalg.solve(np.eye(len(placed.A)) - placed.A, placed.B)
    scale = 1.0 + np.abs(placed.feedback_gain * states).sum()
    error = placed.reference_gain * (placed.C @ states) - 1.0 - placed.feedback_gain @ states
    assert abs(error) <= RUNTIME_TOLERANCE / 8.0 * scale


@pytest.mark.parametrize("delay_s", DELAYS_s)
def test_closed_loop_poles_are_feedback_and_observer_poles_and_zeros(delay_s):
    plant, observer = example(delay_s=delay_s)
    c = linear_controller(observer)
    expected = from_roots(np.concatenate(printed_observer_poles()))
    closed = closed_loop_polynomial(plant, c.R, c.S)
    np.testing.assert_allclose(closed[: len(expected)], expected, atol=1e-9)
    assert np.abs(closed[len(expected) :]).max(initial=0.0) <= 1e-9


@pytest.mark.parametrize("sensor_Hz", [2.0 * RATE_Hz, 3.0 * RATE_Hz, 5.0 * RATE_Hz])
def test_the_pole_of_a_fast_sensor_keeps_its_value(sensor_Hz):
    sections = tuple(Section(frequency_Hz=f) for f in (7e3, sensor_Hz, 9e3))
    plant = plant_from_chain(replace(lateral_chain(), sections=sections))
    slow = Section(frequency_Hz=300.0)
    requested = feedback_poles(plant, slow), observer_poles(plant, slow, 100.0, ())
    observer = place_observer(plant, feedback_poles=requested[0], observer_poles=requested[1])
    c = linear_controller(observer)
    expected = from_roots(np.concatenate(requested))
    closed = closed_loop_polynomial(plant, c.R, c.S)
    np.testing.assert_allclose(closed[: len(expected)], expected, atol=1e-5)


def test_the_four_published_tunings_have_their_published_margins():
    """The truth has an unmodelled Butterworth filter; the table has Ms, |S(10 Hz)|, max |T_v|."""
    chain = lateral_chain()
    truth = plant_from_chain(
        replace(chain, sections=(*chain.sections, Section(frequency_Hz=20e3, damping=0.5**0.5)))
    )
    table = (
        ((630.0, 0.9), (600.0, 0.8), 400.0, 7.7, 0.159, 1.44),
        ((630.0, 0.9), (1200.0, 0.8), 800.0, 4.4, 0.063, 1.07),
        ((630.0, 0.9), (2000.0, 0.8), 1500.0, 6.2, 0.033, 1.50),
        ((1000.0, 0.9), (2000.0, 0.8), 1500.0, 8.3, 0.018, 2.08),
    )
    for feedback, observer, disturbance_Hz, peak_dB, at_10, peak_through in table:
        placed = place_observer(
            plant_from_chain(chain),
            feedback_poles=poles(feedback, (4e3, None), (8.5e3, None)),
            observer_poles=poles(observer, (disturbance_Hz, None), (4200.0, None), (8600.0, None)),
        )
        c = linear_controller(placed)
        assert roots_of(c.S)[np.argmin(abs(roots_of(c.S) - 1.0))] == pytest.approx(1.0, abs=1e-9)
        assert margins(truth, c.R, c.S).modulus_peak_dB == pytest.approx(peak_dB, abs=0.06)
        sensitivity = abs(sensitivities(truth, c.R, c.S, np.array([10.0])).Syp[0])
        assert sensitivity == pytest.approx(at_10, abs=0.0006)
        grid = np.geomspace(10.0, 9.9e3, 4000)
        peak = np.abs(sensitivities(truth, c.R, c.S, grid).Syb).max()
        assert peak == pytest.approx(peak_through, abs=0.006)


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
