"""A largest speed, and barriers climbed by thermal activation."""

import numpy as np
import pytest

from piezoid.operators.filters import activated, slewed


def test_of_a_signal_without_samples_none_is_read() -> None:
    """Under the sanitisers a single one would be seen."""
    nothing = np.empty(0)
    assert slewed(nothing, 0.1).shape == (0,)
    assert activated(nothing, 0.5, 1.0, 1.0).shape == (0,)


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
