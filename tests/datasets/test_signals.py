"""The filters of the laboratory have the response of analog filters at the samples."""

import numpy as np
import pytest

from piezoid_datasets.virtual_lab.signals import (
    coloured_noise,
    first_order,
    held_first_order,
    second_order,
    shifted,
)

ROUNDING = 1e-9  # of a signal of order one, after some hundred steps of a recursion


@pytest.mark.parametrize("time_constant_s", [1e-6, 1e-3, 0.3, 50.0])
def test_a_first_order_lag_of_a_ramp_has_its_closed_form(time_constant_s):
    time_s = np.arange(200) / 100.0
    expected = time_s - time_constant_s * -np.expm1(-time_s / time_constant_s)
    lagged = first_order(time_s, time_constant_s, 100.0, 0.0)
    assert np.allclose(lagged, expected, atol=ROUNDING)
    assert np.array_equal(first_order(time_s, 0.0, 100.0, 5.0), time_s)


def test_a_staircase_with_a_hold_lags_by_a_sample():
    step = np.array([0.0, 1.0, 1.0, 1.0])
    expected = [0.0, 0.0, 1.0 - np.exp(-1.0), 1.0 - np.exp(-2.0)]
    assert np.allclose(held_first_order(step, 0.1, 10.0), expected, atol=ROUNDING)


def test_a_kink_rings_at_the_resonance():
    rate_Hz, frequency_Hz, damping = 5e3, 200.0, 0.05
    time_s = np.arange(400) / rate_Hz
    w, wd = 2 * np.pi * frequency_Hz, 2 * np.pi * frequency_Hz * np.sqrt(1 - damping**2)
    decay = np.exp(-damping * w * time_s)
    swing = 2 * damping * np.cos(wd * time_s)
    swing += (2 * damping**2 - 1) / np.sqrt(1 - damping**2) * np.sin(wd * time_s)
    expected = time_s - 2 * damping / w + decay * swing / w
    assert np.allclose(second_order(time_s, frequency_Hz, damping, rate_Hz), expected, atol=1e-12)
    still = np.full(50, 3.0)
    assert np.array_equal(second_order(still, 100.0, 0.1, 1e3), still)


def test_noise_has_unit_variance_a_slow_share_and_the_sensor_bandwidth(rng):
    white = coloured_noise(200_000, 20e3, 8.5e3, 0.0, rng)
    mixed = coloured_noise(200_000, 20e3, 8.5e3, 0.4, rng)
    assert abs(np.std(white) - 1.0) < 0.02  # four standard errors of 200,000 samples
    slow = [np.std(noise.reshape(-1, 200).mean(axis=1)) for noise in (white, mixed)]
    assert slow[1] > 3.0 * slow[0]
    noise = coloured_noise(200_000, 20e3, 8.5e3, 0.0, rng)
    neighbours = np.mean(noise[1:] * noise[:-1])
    assert abs(neighbours - np.exp(-2 * np.pi * 8.5 / 20)) < 0.01  # four standard errors


def test_a_shifted_signal_begins_with_its_first_value():
    assert np.allclose(shifted(np.array([1.0, 2.0, 4.0]), 0.15, 10.0), [1.0, 1.0, 1.5])
