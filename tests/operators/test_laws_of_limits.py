"""The laws of a largest speed, of thermal activation, and of the Bouc-Wen state."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics.arrays import Array
from piezoid.operators.filters import activated, slewed
from piezoid.operators.library import KERNELS, address
from piezoid.operators.wide_hysteresis import bouc_wen_states
from tests.operators.strategies import GRID, REACH, drives

SIXTEENTHS = st.integers(1, 64).map(lambda steps: steps / GRID)


@given(st.integers(1, 4), drives(least=4), st.floats(-0.99, 0.99), st.integers(0, 40))
def test_a_first_order_filter_is_its_equation_in_every_column_and_may_be_cut(
    columns: int, drive: Array, pole: float, cut: int
) -> None:
    """y[k] = p y[k-1] + b0 x[k] + b1 x[k-1], in place, with the last of both carried on."""
    rows = len(drive) // columns
    x = np.asfortranarray(drive[: rows * columns].reshape(rows, columns))
    carried = np.array([x[0] + 1.0, x[0] - 2.0])
    expected, (before, y) = np.empty_like(x), carried.copy()
    for k, now in enumerate(x):
        y = pole * y + 0.25 * now + 0.5 * before
        expected[k], before = y, now
    parts = [np.array(part, order="F") for part in (x[:cut], x[cut:])]
    for part in parts:
        KERNELS.pk_first_order(
            *(len(part), columns, len(part), address(part), pole, 0.25, 0.5),
            *(address(carried[0]), address(carried[1])),
        )
    np.testing.assert_allclose(np.vstack(parts), expected, rtol=1e-14, atol=1e-14)
    if rows > 0:
        np.testing.assert_array_equal(carried[0], x[-1])


def running_hull(drive: Array) -> tuple[Array, Array]:
    return np.minimum.accumulate(drive), np.maximum.accumulate(drive)


@given(drives(), SIXTEENTHS)
def test_a_slewed_signal_keeps_to_its_step_and_takes_all_of_it_while_behind(
    drive: Array, step: float
) -> None:
    found = slewed(drive, step)
    moved, missing = np.diff(found), drive[1:] - found[:-1]
    np.testing.assert_array_equal(moved, np.clip(missing, -step, step))
    assert found[0] == drive[0]
    np.testing.assert_array_equal(slewed(found, step), found)
    np.testing.assert_array_equal(slewed(-drive, step), -found)
    np.testing.assert_array_equal(slewed(drive, 2 * REACH), drive)


@given(drives(), st.floats(1e-3, 1e3), SIXTEENTHS)
def test_what_is_activated_follows_from_behind_and_settles_at_rest(
    drive: Array, time_s: float, strain: float
) -> None:
    found = activated(drive, time_s, 10.0, strain)
    low, high = running_hull(drive)
    slack = 1e-12 * REACH / strain
    assert ((low - slack <= found) & (found <= high + slack)).all()
    rest = np.concatenate([drive, np.full(10, drive[-1])])
    lag = np.abs(rest - activated(rest, time_s, 10.0, strain))[len(drive) - 1 :]
    assert (np.diff(lag) <= slack).all()
    np.testing.assert_allclose(activated(-drive, time_s, 10.0, strain), -found, atol=slack)


@given(drives(most=15), st.floats(0.1, 3.0), st.floats(0.0, 1.0), st.floats(1.0, 3.0))
def test_a_bouc_wen_state_stays_within_its_saturation_and_is_odd(
    drive: Array, beta: float, share: float, exponent: float
) -> None:
    gamma = share * beta  # softening: |gamma| <= beta
    found = bouc_wen_states(drive / 4, beta, gamma, exponent)
    assert (np.abs(found) <= (beta + gamma) ** (-1.0 / exponent) * (1 + 1e-4)).all()
    np.testing.assert_array_equal(bouc_wen_states(-drive / 4, beta, gamma, exponent), -found)
