"""Delays, lags, ladders and limits against what shares no code with them."""

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
def test_every_row_to_keep_lies_on_the_straight_line_that_many_samples_before(
    numbers: bytes, samples: float, rows: tuple[int, int, int]
) -> None:
    moved, keep = np.frombuffer(numbers, np.int8) / 16, slice(*rows)
    place = np.arange(len(moved))
    # Before the first sample it stood where the first sample is. Sixteenths round nothing.
    expected = np.interp(place - samples, place, moved)[keep]
    np.testing.assert_array_equal(lagged(moved, "delay", samples / 8, 8.0, keep=keep), expected)
    both = np.column_stack([moved, -moved])
    np.testing.assert_array_equal(
        later(both, samples, keep), np.column_stack([expected, -expected])
    )


def behind(signal: Array, pole: float, b0: float, b1: float) -> Array:
    """Follow one rung sample by sample."""
    found, before = [float(signal[0])], float(signal[0])
    for now in signal[1:].tolist():
        found.append(pole * found[-1] + b0 * now + b1 * before)
        before = now
    return np.array(found)


@pytest.mark.parametrize("share", [1.0, np.array([0.5, 0.0, -2.0, 0.1])])
def test_a_ladder_is_the_sum_of_its_rungs(share: Array) -> None:
    signal = 3.0 + np.cumsum(np.random.default_rng(1).normal(size=2_000))
    rungs = np.array([behind(signal, *rung) for rung in RUNGS])
    apart = np.broadcast_to(share, len(RUNGS)) @ rungs
    np.testing.assert_allclose(ladder(signal, RUNGS, share), apart, rtol=1e-12, atol=1e-12)


def test_a_lag_filters_every_column_as_a_rung() -> None:
    columns = np.random.default_rng(2).normal(size=(300, 3))
    expected = np.column_stack([behind(column, *RUNGS[1]) for column in columns.T])
    np.testing.assert_allclose(relaxed(columns, TIMES_s[1], RATE_Hz), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("time_s", "strain"), [(1e-3, 0.03), (0.02, 1e-3), (1e-6, 0.3), (3.0, 0.9)]
)
def test_what_is_activated_is_what_every_step_and_every_wait_leave_of_the_lag(
    time_s: float, strain: float
) -> None:
    way = np.cumsum(np.random.default_rng(2).normal(0.0, 0.02, 3_000))
    worn, wide, lag = np.exp(-1.0 / (time_s * 1000.0)), 2.0 * strain, 0.0
    expected = [way[0]]
    for step in np.diff(way):
        lag = wide * np.arctanh(worn * np.tanh((lag + step) / wide))
        expected.append(lag)
    found = way - activated(way, time_s, 1000.0, strain)
    np.testing.assert_allclose(found[1:], expected[1:], atol=1e-11)


def test_a_step_as_large_as_you_like_is_activated_to_a_finite_lag() -> None:
    found = activated(np.array([0.0, 1e300, -1e300, 3.0]), 1e-3, 1000.0, 1e-3)
    assert np.isfinite(found).all()


def test_a_slewed_signal_keeps_to_its_step_and_takes_all_of_it_while_behind() -> None:
    drive = np.random.default_rng(3).integers(-40, 40, 200) / 16.0  # sixteenths round nothing
    found = slewed(drive, 0.375)
    assert found[0] == drive[0]
    missing = drive[1:] - found[:-1]
    np.testing.assert_array_equal(np.diff(found), np.clip(missing, -0.375, 0.375))
