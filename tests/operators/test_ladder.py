"""Ladders of first-order filters against the filters one by one."""

import numpy as np

from piezoid.diagnosis.signals import laddered, relaxed
from piezoid.operators.ladder import ladder


def test_a_ladder_is_the_sum_of_its_rungs() -> None:
    signal = 3.0 + np.cumsum(np.random.default_rng(1).normal(size=5_000))
    times_s = (1e-4, 0.02, 0.7, 90.0)
    apart = sum(relaxed(signal, time_s, 500.0) for time_s in times_s)
    np.testing.assert_allclose(laddered(signal, times_s, 500.0), apart, rtol=1e-12)


def test_a_ladder_stands_still_where_its_signal_does() -> None:
    np.testing.assert_allclose(laddered(np.full(50, 2.5), (0.1, 4.0), 10.0), 5.0, rtol=1e-12)


def test_a_ladder_without_rungs_holds_nothing_up() -> None:
    np.testing.assert_array_equal(ladder(np.arange(4.0), []), np.zeros(4))
