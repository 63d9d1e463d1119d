"""Feedforward of the reference: filter and preview, and the filter in sections."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.feedforward import filter_sections, fit_reference_path
from piezoid.design.hysteresis_bounds import affine_bounds
from piezoid.design.observer import linear_controller
from piezoid.design.plant import Section
from piezoid.design.rst import feedback_poles, observer_poles
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.numerics.polynomial import product, response
from tests.design.hysteretic import REACH_V, hysteresis, loop
from tests.design.placed import place_observer
from tests.design.rig import RATE_Hz, lateral_chain


def test_filter_and_preview_remove_the_lag_of_a_sine():
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    plant, observer = loop(bounds)
    c = linear_controller(observer)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=100.0)
    assert path.filter.sum() == pytest.approx(1.0, abs=1e-12)
    assert path.error < 0.05 * path.plain_error
    n, p = 4000, path.preview_samples
    reference = np.sin(2 * np.pi * 80.0 / RATE_Hz * np.arange(n))
    closed = closed_loop_polynomial(plant, c.R, c.S)
    y = lfilter(product(c.T, path.filter, plant.B), closed, reference)
    error = reference[2000 : n - p] - y[2000 + p :]
    assert np.abs(error).max() <= 1.05 * path.error


def test_a_loop_of_two_hertz_follows_a_reference_of_a_hundred():
    chain = lateral_chain()
    plant = plant_from_chain(replace(chain, sections=(Section(frequency_Hz=150.0),)))
    slow = Section(frequency_Hz=30.0)
    observer = place_observer(
        plant,
        feedback_poles=feedback_poles(plant, slow),
        observer_poles=observer_poles(plant, slow, 2.0, ()),
    )
    c = linear_controller(observer)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=2.0)
    numerator = product(product(c.T, path.filter), plant.B)
    closed = response(numerator, closed_loop_polynomial(plant, c.R, c.S), [100.0], RATE_Hz)[0]
    advance = np.exp(2j * np.pi * 100.0 / RATE_Hz * path.preview_samples)
    assert abs(1.0 - closed * advance) < 0.02  # 1.2 where the filter is fitted up to 2 Hz only


def test_a_mode_slower_than_a_thousandth_of_the_sampling_is_not_inverted():
    sections = (Section(frequency_Hz=15.0, damping=0.02), Section(frequency_Hz=5e3))
    plant = plant_from_chain(replace(lateral_chain(), sections=sections))
    observer = place_observer(
        plant,
        feedback_poles=feedback_poles(plant, sections[0]),
        observer_poles=observer_poles(plant, Section(frequency_Hz=30.0, damping=0.8), 1.0, ()),
    )
    c = linear_controller(observer)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=4.0)
    assert np.abs(path.filter).max() < 3.0


@pytest.mark.parametrize("taps", [2, 3, 7, 9])
@pytest.mark.parametrize("delay", [0, 1, 4])
def test_sections_multiply_to_the_filter_with_unit_gain_at_rest(taps, delay, rng):
    """A filter that begins with zeros has further sections of pure delay."""
    coefficients = np.concatenate([np.zeros(delay), rng.normal(size=taps)])
    coefficients /= coefficients.sum()
    sections = filter_sections(coefficients)
    np.testing.assert_allclose(sections[:, :3].sum(axis=1), 1.0, rtol=1e-12)
    product = np.ones(1)
    for section in sections:
        product = np.convolve(product, section[:3])
    np.testing.assert_allclose(product[: delay + taps], coefficients, atol=1e-9)
    np.testing.assert_allclose(product[delay + taps :], 0.0, atol=1e-12)
    assert len(sections) <= delay // 2 + delay % 2 + taps // 2
