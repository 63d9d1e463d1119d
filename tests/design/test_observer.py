"""The disturbance observer: its worked example, delays, resonant modes, published tunings."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid.design.observer import (
    DisturbanceObserver,
    disturbance_model,
    linear_controller,
    with_oscillators_as_states,
)
from piezoid.design.plant import Plant, Section, plant_from_chain
from piezoid.design.rst import feedback_poles, observer_poles
from piezoid.design.sensitivity import closed_loop_polynomial, margins, sensitivities
from piezoid.numerics.polynomial import from_roots, roots_of
from tests.design.placed import place_observer
from tests.design.rig import RATE_Hz, lateral_chain, poles, printed_observer_poles
from tests.design.stepping import with_observer, with_polynomials

PRINTED = 5.1e-11
PRINTED_CLOSED_LOOP = np.concatenate(
    [
        (1, -4.5750108263, 8.9001057978, -9.5574086345, 6.1517173975),
        (-2.4126438412, 0.5616117386, -0.0724327942, 0.004516861, -0.0001052682),
    ]
)
RUNTIME_ASKS = 64.0 * np.finfo(float).eps  # `near` in piezoid_runtime.c
DELAYS_s = (0.0, 20e-6, 50e-6, 120e-6)


def example(gain: float = 1.0, delay_s: float = 0.0) -> tuple[Plant, DisturbanceObserver]:
    plant = plant_from_chain(lateral_chain(gain, delay_s))
    feedback, observer = printed_observer_poles()
    return plant, place_observer(plant, feedback_poles=feedback, observer_poles=observer)


@pytest.mark.parametrize("name", ["B", "C", "state_gain", "disturbance_gain", "feedback_gain"])
def test_an_observer_of_gains_that_do_not_fit_together_is_refused(name: str):
    _, observer = example()
    with pytest.raises(ValueError, match=f"{name} has 9 values"):
        replace(observer, **{name: np.ones(9)})


@pytest.mark.parametrize("output", [[], [1.0, 0.0]])
def test_a_disturbance_of_other_states_than_its_output_is_refused(output: list[float]):
    with pytest.raises(ValueError, match="outputs of a transition"):
        replace(disturbance_model(1000.0), output=np.array(output))


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


def test_a_plant_gain_scales_the_controller_and_nothing_else():
    _, one = example()
    _, scaled = example(gain=3.5e-6)
    a, b = linear_controller(one), linear_controller(scaled)
    np.testing.assert_allclose(b.R * 3.5e-6, a.R, atol=1e-11)
    np.testing.assert_allclose(b.S, a.S, atol=1e-11)
    assert scaled.reference_gain * 3.5e-6 == pytest.approx(one.reference_gain, rel=1e-11)


@given(st.floats(-9.0, 0.0), st.floats(0.0, 8.0), st.floats(30.0, 3000.0), st.floats(30.0, 3000.0))
def test_a_stage_without_a_mode_rests_as_exactly_as_the_runtime_asks(
    decades: float, late: float, feedback_Hz: float, observed_Hz: float
) -> None:
    with_mode = lateral_chain(10.0**decades, late / RATE_Hz)
    plant = plant_from_chain(replace(with_mode, sections=with_mode.sections[::2]))
    observer = Section(frequency_Hz=observed_Hz)
    o = place_observer(
        plant,
        feedback_poles=feedback_poles(plant, Section(frequency_Hz=feedback_Hz)),
        observer_poles=observer_poles(plant, observer, observed_Hz, ()),
    )
    rest = np.linalg.solve(np.eye(len(o.A)) - o.A, o.B)
    scale = 1.0 + np.abs(o.feedback_gain * rest).sum()
    left = o.reference_gain * (o.C @ rest) - 1.0 - o.feedback_gain @ rest
    assert abs(left) <= RUNTIME_ASKS / 8.0 * scale


@pytest.mark.parametrize("delay_s", DELAYS_s)
def test_closed_loop_poles_are_feedback_and_observer_poles_and_zeros(delay_s):
    plant, observer = example(delay_s=delay_s)
    c = linear_controller(observer)
    wanted = from_roots(np.concatenate(printed_observer_poles()))
    closed = closed_loop_polynomial(plant, c.R, c.S)
    np.testing.assert_allclose(closed[: len(wanted)], wanted, atol=1e-9)
    assert np.abs(closed[len(wanted) :]).max(initial=0.0) <= 1e-9


@pytest.mark.parametrize("sensor_Hz", [2.0 * RATE_Hz, 3.0 * RATE_Hz, 5.0 * RATE_Hz])
def test_the_pole_of_a_sensor_quicker_than_the_sampling_stays_where_it_is(sensor_Hz: float):
    sections = tuple(Section(frequency_Hz=f) for f in (7e3, sensor_Hz, 9e3))
    plant = plant_from_chain(replace(lateral_chain(), sections=sections))
    slow = Section(frequency_Hz=300.0)
    wanted = feedback_poles(plant, slow), observer_poles(plant, slow, 100.0, ())
    o = place_observer(plant, feedback_poles=wanted[0], observer_poles=wanted[1])
    c = linear_controller(o)
    expected = from_roots(np.concatenate(wanted))
    closed = closed_loop_polynomial(plant, c.R, c.S)
    np.testing.assert_allclose(closed[: len(expected)], expected, atol=1e-5)


@pytest.mark.parametrize("delay_s", DELAYS_s)
def test_observer_and_polynomials_are_the_same_controller(delay_s, rng):
    plant, observer = example(delay_s=delay_s)
    reference, d_V = rng.normal(size=150), rng.normal(size=150)
    y, _ = with_observer(plant, observer, reference, d_V, np.zeros(150))
    c = linear_controller(observer)
    other = with_polynomials(plant, c, reference, d_V, np.zeros(150))
    np.testing.assert_allclose(other, y, atol=1e-8 * np.abs(y).max())


def test_a_constant_disturbance_leaves_nothing_and_the_reference_is_reached():
    plant, observer = example()
    y, _ = with_observer(plant, observer, np.ones(600), np.full(600, 0.4), np.zeros(600))
    assert y[-1] == pytest.approx(1.0, abs=1e-10)


def test_an_oscillator_removes_a_sine_at_its_frequency():
    plant = plant_from_chain(lateral_chain())
    feedback, observer = printed_observer_poles()
    model = disturbance_model(RATE_Hz, (100.0,))
    resonant = place_observer(
        plant,
        feedback_poles=feedback,
        observer_poles=np.concatenate([observer, poles((100.0, 0.7))]),
        disturbance=model,
    )
    c = linear_controller(resonant)
    at = np.array([1.0, 100.0])
    assert abs(sensitivities(plant, c.R, c.S, at).Syp[1]) <= 1e-8
    plain = linear_controller(example()[1])
    assert abs(sensitivities(plant, plain.R, plain.S, at).Syp[1]) > 0.5
    sine = np.sin(2 * np.pi * 100.0 / RATE_Hz * np.arange(4000))
    y, _ = with_observer(plant, resonant, np.zeros(4000), sine, np.zeros(4000))
    assert np.abs(y[-400:]).max() <= 1e-6


def test_oscillators_may_stand_among_the_states():
    plant = plant_from_chain(lateral_chain())
    feedback, observer = printed_observer_poles()
    resonant = place_observer(
        plant,
        feedback_poles=feedback,
        observer_poles=np.concatenate([observer, poles((60.0, 0.7))]),
        disturbance=disturbance_model(RATE_Hz, (60.0,)),
    )
    merged = with_oscillators_as_states(resonant)
    assert len(merged.disturbance_gain) == 1
    a, b = linear_controller(resonant), linear_controller(merged)
    np.testing.assert_allclose(b.R, a.R, atol=1e-10)
    np.testing.assert_allclose(b.S, a.S, atol=1e-10)
    assert with_oscillators_as_states(merged) is merged


def test_a_disturbance_is_a_constant_and_sines_of_as_many_volts_as_their_states():
    model = disturbance_model(RATE_Hz, (100.0, 300.0))
    w, k = np.array([0.5, 1.0, 0.0, 2.0, 0.0]), np.arange(400)
    found = [model.output @ np.linalg.matrix_power(model.transition, n) @ w for n in k]
    turn = 2 * np.pi * k / RATE_Hz
    expected = 0.5 + np.cos(100.0 * turn) + 2.0 * np.cos(300.0 * turn)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_the_four_published_tunings_have_their_published_margins():
    """Truth with a Butterworth filter that the model has not; Ms, |S(10 Hz)|, max |T_v|."""
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
    for feedback, observer, disturbance_Hz, peak_dB, at_10, through in table:
        o = place_observer(
            plant_from_chain(chain),
            feedback_poles=poles(feedback, (4e3, None), (8.5e3, None)),
            observer_poles=poles(observer, (disturbance_Hz, None), (4200.0, None), (8600.0, None)),
        )
        c = linear_controller(o)
        assert roots_of(c.S)[np.argmin(abs(roots_of(c.S) - 1.0))] == pytest.approx(1.0, abs=1e-9)
        assert margins(truth, c.R, c.S).modulus_peak_dB == pytest.approx(peak_dB, abs=0.06)
        left = abs(sensitivities(truth, c.R, c.S, np.array([10.0])).Syp[0])
        assert left == pytest.approx(at_10, abs=0.0006)
        grid = np.geomspace(10.0, 9.9e3, 4000)
        peak = np.abs(sensitivities(truth, c.R, c.S, grid).Syb).max()
        assert peak == pytest.approx(through, abs=0.006)
