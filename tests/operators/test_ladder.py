"""Ladders of first-order filters against the filters one by one."""

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.operators.filters import FirstOrder, ladder, relaxed

RATE_Hz = 500.0
TIMES_s = (1e-4, 0.02, 0.7, 90.0)
RUNGS = [FirstOrder(time_s=time_s, rate_Hz=RATE_Hz).coefficients for time_s in TIMES_s]


def behind(signal: np.ndarray, pole: float, b0: float, b1: float) -> np.ndarray:
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
