"""The tunnelling loop: published polynomials on the logarithm, and the guards around them."""

import math

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.library import library
from piezoid.runtime.schema import MAX_TAPS
from tests.runtime.runtime_parameters import RST_A, RST_B, RST_R, RST_S, tunnelling

REFERENCE_A = 1e-9


def started(volts=0.0, current_A=REFERENCE_A, precision="double", **others):
    controller = Controller(tunnelling(**others), precision=precision)
    controller.start(volts, current_A)
    return controller


class Gap:
    """ln(i / i_0) = B/A u: y[k] = -a1 y[k-1] - a2 y[k-2] + b2 u[k-2] + b3 u[k-3]."""

    def __init__(self, gain=1.0):
        self.y, self.u, self.gain = np.zeros(3), np.zeros(4), gain

    def current_A(self):
        return REFERENCE_A * math.exp(min(self.y[0], 50.0))

    def drive(self, volts):
        self.u = np.r_[volts, self.u[:-1]]
        new = self.gain * (RST_B[2:] @ self.u[1:3]) - RST_A[1:] @ self.y[:2]
        self.y = np.r_[new, self.y[:-1]]


def close_loop(controller, gap, reference_A, surface=0.0):
    """Logarithm of the current and voltage; ``surface`` is added to the logarithm."""
    log, voltage = np.empty((2, len(reference_A)))
    for k, wanted in enumerate(reference_A):
        log[k] = gap.y[0] + surface
        voltage[k] = controller.step(wanted, REFERENCE_A * math.exp(log[k]))
        gap.drive(voltage[k])
    return log, voltage


def test_a_step_of_the_setpoint_obeys_the_published_closed_loop():
    """(A S + B R) y = B T r, with r the logarithm of the setpoint."""
    reference = np.full(200, 1.5 * REFERENCE_A)
    y, _ = close_loop(started(), Gap(), reference)
    polynomial = np.convolve(RST_A, RST_S)
    polynomial = polynomial + np.r_[np.convolve(RST_B, RST_R)]
    left = np.convolve(polynomial, y)[:200]
    right = np.convolve(RST_B * RST_R.sum(), np.full(200, math.log(1.5)))[:200]
    # The first differences feel that the step was not there before the start.
    assert np.abs(left - right).max() < 1e-9
    assert y[-1] == pytest.approx(math.log(1.5), abs=1e-9)


def test_float_holds_the_setpoint_without_drift():
    """The integrator is exact in single precision: only S without it is rounded."""
    gap = Gap()
    controller = started(precision="float")
    y, _ = close_loop(controller, gap, np.full(3000, 1.5 * REFERENCE_A), surface=-1.0)
    assert abs(y[-1] - math.log(1.5)) < 1e-4


def test_the_start_does_not_bump():
    controller = started(volts=3.25, current_A=0.7 * REFERENCE_A)
    assert controller.step(0.7 * REFERENCE_A, 0.7 * REFERENCE_A) == 3.25


def test_a_lost_current_gives_a_bounded_approach():
    controller = started(voltage_step_V=0.002)
    u = controller.run(np.full(200, REFERENCE_A), np.full(200, 1e-14)).voltage_V
    assert controller.status_ever & Status.CURRENT_LOST
    assert 0 < np.diff(u).max() <= 0.002 + 1e-15
    floor = np.full(200, 1e-11)
    assert np.array_equal(started(voltage_step_V=0.002).run(floor * 100, floor).voltage_V, u)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_reference_that_is_no_current_is_replaced_by_the_last(bad):
    currents = np.full(3, REFERENCE_A)
    run = started().run(REFERENCE_A * np.array([2.0, bad, 1.5]), currents)
    kept = started().run(REFERENCE_A * np.array([2.0, 2.0, 1.5]), currents)
    assert np.array_equal(run.voltage_V, kept.voltage_V)
    assert list(run.status) == [0, Status.BAD_REFERENCE, 0]


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("current_A", [1e-14, 0.0, -1e-12, 3e-11, 0.2e-9])
def test_no_reading_far_below_the_set_point_makes_the_tip_faster(current_A, precision):
    """Neither floor nor an amplifier's offset: the loop integrates none of it."""
    controller = started(current_A=1e-12, precision=precision, contact_log=0.7)
    run = controller.run(np.full(300, REFERENCE_A), np.full(300, current_A))
    assert np.diff(run.voltage_V) == pytest.approx(np.full(299, 1e-3), rel=1e-3)
    assert (run.status & Status.APPROACHING).all()
    controller.schedule(2.0)
    run = controller.run(np.full(10, REFERENCE_A), np.full(10, current_A))
    assert np.diff(run.voltage_V) == pytest.approx(np.full(9, 0.5e-3), rel=1e-3)


def test_a_reference_beyond_the_currents_is_the_last_of_them_and_that_is_said():
    currents = np.full(3, REFERENCE_A)
    run = started().run(np.array([1e-12, 1.0, REFERENCE_A]), currents)
    kept = started().run(np.array([1e-11, 2e-8, REFERENCE_A]), currents)
    assert np.array_equal(run.voltage_V, kept.voltage_V)
    assert list(run.status) == [Status.REFERENCE_LIMITED] * 2 + [0]
    assert not kept.status.any()


def test_polynomials_that_fill_their_tables_are_the_written_equation(rng):
    """R and T reach back as far as there is room; S and A_0 too, at limits that are met."""
    R, T, S, a0 = (1e-3 * rng.normal(size=MAX_TAPS) for _ in range(4))
    S[0] = a0[0] = 1.0
    given = {f"rst_{name}_count": MAX_TAPS for name in ("R", "T", "S", "A0")}
    given |= {"rst_R_V": R, "rst_T_V": T, "rst_S": S, "rst_A0": a0}
    y, r = np.zeros((2, 200 + MAX_TAPS))
    y[MAX_TAPS:], r[MAX_TAPS:] = rng.normal(0.0, 0.5, (2, 200))
    currents = REFERENCE_A * np.exp([r[MAX_TAPS:], y[MAX_TAPS:]])
    given |= {"voltage_minimum_V": -5e-3, "voltage_maximum_V": 5e-3, "retract_voltage_V": 0.0}
    shipped = started(**given).run(*currents).voltage_V
    change, excess = np.zeros((2, len(y)))
    volts = np.zeros(len(y))
    for k in range(MAX_TAPS, len(y)):
        now, before = slice(k, k - MAX_TAPS, -1), slice(k - 1, k - MAX_TAPS, -1)
        wanted = volts[k - 1] + T @ r[now] - R @ y[now] - S[1:] @ change[before]
        wanted += a0[1:] @ excess[before]
        volts[k] = np.clip(wanted, -5e-3, 5e-3)
        change[k], excess[k] = volts[k] - volts[k - 1], volts[k] - wanted
    assert np.abs(shipped - volts[MAX_TAPS:]).max() < 1e-12
    assert (excess != 0.0).sum() > 50


def test_at_the_limits_nothing_winds_up():
    reference = np.r_[np.full(500, 1e-8), np.full(100, REFERENCE_A)]
    limited = started(voltage_maximum_V=1e-3, voltage_minimum_V=-10.0)
    y, u = close_loop(limited, Gap(), reference)
    assert u[400] == 1e-3
    assert np.abs(y[560:]).max() < 1e-3


def test_the_gain_schedule_gives_a_scaled_plant_the_loop_of_the_first():
    reference = np.full(200, 1.5 * REFERENCE_A)
    designed, u = close_loop(started(), Gap(), reference)
    scheduled = started()
    scheduled.schedule(2.0)
    twice, half = close_loop(scheduled, Gap(gain=2.0), reference)
    assert np.abs(twice - designed).max() < 1e-9
    assert np.abs(2 * half - u).max() < 1e-12


def test_the_schedule_stays_inside_its_limit():
    wild, limited = started(), started()
    wild.schedule(1e9)
    limited.schedule(4.0)
    wild.schedule(np.nan)
    assert wild.step(2e-9, 1e-9) == limited.step(2e-9, 1e-9)


@pytest.mark.parametrize(("precision", "eps"), [("double", 2.0**-52), ("float", 2.0**-23)])
def test_the_logarithm_is_within_one_unit_in_the_last_place(precision, eps, rng):
    opened = library(precision)
    dtype = np.dtype(opened.real)
    x = np.exp(rng.uniform(-80, 80, 20000)).astype(dtype)
    x = np.r_[x, (1 + rng.uniform(-0.3, 0.5, 20000)).astype(dtype), dtype.type(1)]
    exact = np.log(x.astype(np.longdouble))
    found = np.array([opened.code.pz_log(value) for value in x])
    unit = eps * 2.0 ** np.floor(np.log2(np.maximum(np.abs(exact), 0.5).astype(float)))
    assert np.abs((found - exact) / unit).max() < 1.0
    assert opened.code.pz_log(1.0) == 0.0
