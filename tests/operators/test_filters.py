"""Delays, lags, ladders and limits against independent implementations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.filters import (
    FirstOrder,
    activated,
    ladder,
    lagged,
    later,
    relaxed,
    slewed,
)

SIXTEENTHS = st.integers(0, 40 * 16).map(lambda count: count / 16)
RATE_Hz = 500.0
TIMES_s = (1e-4, 0.02, 0.7, 90.0)
RUNGS = [FirstOrder(time_s=time_s, rate_Hz=RATE_Hz).coefficients for time_s in TIMES_s]


@given(
    st.binary(min_size=1, max_size=30),
    SIXTEENTHS,
    st.tuples(st.integers(0, 30), st.integers(0, 30), st.integers(1, 7)),
)
def test_a_delay_interpolates_linearly_in_any_selection_of_rows(numbers, samples, rows):
    signal, keep = np.frombuffer(numbers, np.int8) / 16, slice(*rows)
    sample = np.arange(len(signal))
    # The signal is constant before its first sample. Sixteenths add without rounding.
    expected = np.interp(sample - samples, sample, signal)[keep]
    np.testing.assert_array_equal(lagged(signal, "delay", samples / 8, 8.0, keep=keep), expected)
    columns = np.column_stack([signal, -signal])
    np.testing.assert_array_equal(
        later(columns, samples, keep), np.column_stack([expected, -expected])
    )


def run_rung(signal: Array, pole: float, b0: float, b1: float) -> Array:
    """Run one rung of a ladder sample by sample."""
    output, previous = [float(signal[0])], float(signal[0])
    for value in signal[1:].tolist():
        output.append(pole * output[-1] + b0 * value + b1 * previous)
        previous = value
    return np.array(output)


@pytest.mark.parametrize("share", [1.0, np.array([0.5, 0.0, -2.0, 0.1])])
def test_a_ladder_is_the_sum_of_its_rungs(share):
    signal = 3.0 + np.cumsum(np.random.default_rng(1).normal(size=2_000))
    rungs = np.array([run_rung(signal, *rung) for rung in RUNGS])
    expected = np.broadcast_to(share, len(RUNGS)) @ rungs
    np.testing.assert_allclose(
        ladder(signal, TIMES_s, RATE_Hz, share), expected, rtol=1e-12, atol=1e-12
    )


def test_a_lag_filters_every_column_as_a_rung():
    columns = np.random.default_rng(2).normal(size=(300, 3))
    expected = np.column_stack([run_rung(column, *RUNGS[1]) for column in columns.T])
    np.testing.assert_allclose(relaxed(columns, TIMES_s[1], RATE_Hz), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("time_s", "strain"), [(1e-3, 0.03), (0.02, 1e-3), (1e-6, 0.3), (3.0, 0.9)]
)
def test_thermal_activation_relaxes_the_lag_after_every_step(time_s, strain):
    path = np.cumsum(np.random.default_rng(2).normal(0.0, 0.02, 3_000))
    decay, scale, lag = np.exp(-1.0 / (time_s * 1000.0)), 2.0 * strain, 0.0
    expected = [path[0]]
    for step in np.diff(path):
        lag = scale * np.arctanh(decay * np.tanh((lag + step) / scale))
        expected.append(lag)
    lags = path - activated(path, time_s, 1000.0, strain)
    np.testing.assert_allclose(lags[1:], expected[1:], atol=1e-11)


def test_thermal_activation_of_a_huge_step_is_finite():
    output = activated(np.array([0.0, 1e300, -1e300, 3.0]), 1e-3, 1000.0, 1e-3)
    assert np.isfinite(output).all()


def test_a_slew_limit_clips_every_step_towards_the_signal():
    drive = np.random.default_rng(3).integers(-40, 40, 200) / 16.0  # sixteenths round nothing
    output = slewed(drive, 0.375)
    assert output[0] == drive[0]
    error = drive[1:] - output[:-1]
    np.testing.assert_array_equal(np.diff(output), np.clip(error, -0.375, 0.375))
