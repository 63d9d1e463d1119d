"""A largest speed, and barriers climbed by thermal activation."""

import numpy as np
import pytest

from piezoid.operators.filters import activated, slewed


@pytest.mark.parametrize(
    ("time_s", "strain"), [(1e-3, 0.03), (0.02, 1e-3), (1e-6, 0.3), (3.0, 0.9)]
)
def test_what_is_activated_is_what_every_step_and_every_wait_leave_of_the_lag(
    time_s, strain
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
