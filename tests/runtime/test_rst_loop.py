"""The tunnelling loop: published polynomials on the logarithm, and the guards around them."""

import math

import numpy as np
import pytest

from piezoid.runtime.controller import Status
from piezoid.runtime.library import library
from piezoid.runtime.schema import MAX_TAPS
from tests.runtime import runtime_parameters
from tests.runtime.runtime_parameters import RST_A, RST_B, RST_R, RST_S, tunnelling

REFERENCE_A = 1e-9


def started(volts=0.0, current_A=REFERENCE_A, precision="double", **overrides):
    return runtime_parameters.started(tunnelling(**overrides), volts, current_A, precision)


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
    """Return the logarithm of the current, shifted by ``surface``, and the voltage."""
    log, voltage = np.empty((2, len(reference_A)))
    for k, set_point_A in enumerate(reference_A):
        log[k] = gap.y[0] + surface
        voltage[k] = controller.step(set_point_A, REFERENCE_A * math.exp(log[k]))
        gap.drive(voltage[k])
    return log, voltage


def test_a_step_of_the_setpoint_obeys_the_published_closed_loop():
    """(A S + B R) y = B T r, with r the logarithm of the setpoint."""
    reference = np.full(200, 1.5 * REFERENCE_A)
    y, _ = close_loop(started(), Gap(), reference)
    polynomial = np.convolve(RST_A, RST_S)
    polynomial = polynomial + np.r_[np.convolve(RST_B, RST_R)]
    output = np.convolve(polynomial, y)[:200]
    input_terms = np.convolve(RST_B * RST_R.sum(), np.full(200, math.log(1.5)))[:200]
    # The step begins with the start, so the first differences include it.
    assert np.abs(output - input_terms).max() < 1e-9
    assert y[-1] == pytest.approx(math.log(1.5), abs=1e-9)


def test_the_start_has_no_bump_and_float_holds_the_setpoint():
    """The integrator is exact in single precision; only S without it is rounded."""
    gap = Gap()
    controller = started(precision="float")
    y, _ = close_loop(controller, gap, np.full(3000, 1.5 * REFERENCE_A), surface=-1.0)
    assert abs(y[-1] - math.log(1.5)) < 1e-4
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
def test_an_invalid_reference_is_replaced_by_the_previous_one(bad):
    currents = np.full(3, REFERENCE_A)
    run = started().run(REFERENCE_A * np.array([2.0, bad, 1.5]), currents)
    expected = started().run(REFERENCE_A * np.array([2.0, 2.0, 1.5]), currents)
    assert np.array_equal(run.voltage_V, expected.voltage_V)
    assert list(run.status) == [0, Status.BAD_REFERENCE, 0]


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("current_A", [1e-14, 0.0, -1e-12, 3e-11, 0.2e-9])
def test_a_reading_far_below_the_set_point_keeps_the_approach_speed(current_A, precision):
    """The loop integrates neither the floor nor an offset of the amplifier."""
    controller = started(current_A=1e-12, precision=precision, contact_log=0.7)
    run = controller.run(np.full(300, REFERENCE_A), np.full(300, current_A))
    assert np.diff(run.voltage_V) == pytest.approx(np.full(299, 1e-3), rel=1e-3)
    assert (run.status & Status.APPROACHING).all()
    controller.schedule(2.0)
    run = controller.run(np.full(10, REFERENCE_A), np.full(10, current_A))
    assert np.diff(run.voltage_V) == pytest.approx(np.full(9, 0.5e-3), rel=1e-3)


def test_a_reference_out_of_range_is_limited_and_reported():
    currents = np.full(3, REFERENCE_A)
    run = started().run(np.array([1e-12, 1.0, REFERENCE_A]), currents)
    expected = started().run(np.array([1e-11, 2e-8, REFERENCE_A]), currents)
    assert np.array_equal(run.voltage_V, expected.voltage_V)
    assert list(run.status) == [Status.REFERENCE_LIMITED] * 2 + [0]
    assert not expected.status.any()


def test_polynomials_that_fill_their_tables_obey_their_equation(rng):
    """R, T, S and A_0 have the largest order, and the voltage reaches its limits."""
    R, T, S, a0 = (1e-3 * rng.normal(size=MAX_TAPS) for _ in range(4))
    S[0] = a0[0] = 1.0
    parameters = {f"rst_{name}_count": MAX_TAPS for name in ("R", "T", "S", "A0")}
    parameters |= {"rst_R_V": R, "rst_T_V": T, "rst_S": S, "rst_A0": a0}
    y, r = np.zeros((2, 200 + MAX_TAPS))
    y[MAX_TAPS:], r[MAX_TAPS:] = rng.normal(0.0, 0.5, (2, 200))
    currents = REFERENCE_A * np.exp([r[MAX_TAPS:], y[MAX_TAPS:]])
    parameters |= {"voltage_minimum_V": -5e-3, "voltage_maximum_V": 5e-3, "retract_voltage_V": 0.0}
    shipped = started(**parameters).run(*currents).voltage_V
    change, excess = np.zeros((2, len(y)))
    volts = np.zeros(len(y))
    for k in range(MAX_TAPS, len(y)):
        present, past = slice(k, k - MAX_TAPS, -1), slice(k - 1, k - MAX_TAPS, -1)
        unlimited = volts[k - 1] + T @ r[present] - R @ y[present] - S[1:] @ change[past]
        unlimited += a0[1:] @ excess[past]
        volts[k] = np.clip(unlimited, -5e-3, 5e-3)
        change[k], excess[k] = volts[k] - volts[k - 1], volts[k] - unlimited
    assert np.abs(shipped - volts[MAX_TAPS:]).max() < 1e-12
    assert (excess != 0.0).sum() > 50


def test_a_saturated_loop_does_not_wind_up():
    reference = np.r_[np.full(500, 1e-8), np.full(100, REFERENCE_A)]
    limited = started(voltage_maximum_V=1e-3, voltage_minimum_V=-10.0)
    y, u = close_loop(limited, Gap(), reference)
    assert u[400] == 1e-3
    assert np.abs(y[560:]).max() < 1e-3


def test_the_gain_schedule_compensates_a_scaled_plant_within_its_limit():
    reference = np.full(200, 1.5 * REFERENCE_A)
    designed, u = close_loop(started(), Gap(), reference)
    scheduled = started()
    scheduled.schedule(2.0)
    scheduled_y, scheduled_u = close_loop(scheduled, Gap(gain=2.0), reference)
    assert np.abs(scheduled_y - designed).max() < 1e-9
    assert np.abs(2 * scheduled_u - u).max() < 1e-12
    extreme, limited = started(), started()
    extreme.schedule(1e9)
    limited.schedule(4.0)
    extreme.schedule(np.nan)
    assert extreme.step(2e-9, 1e-9) == limited.step(2e-9, 1e-9)


@pytest.mark.parametrize(("precision", "eps"), [("double", 2.0**-52), ("float", 2.0**-23)])
def test_the_logarithm_is_within_one_unit_in_the_last_place(precision, eps, rng):
    runtime = library(precision)
    dtype = np.dtype(runtime.real)
    x = np.exp(rng.uniform(-80, 80, 20000)).astype(dtype)
    x = np.r_[x, (1 + rng.uniform(-0.3, 0.5, 20000)).astype(dtype), dtype.type(1)]
    exact = np.log(x.astype(np.longdouble))
    logarithm = np.array([runtime.code.pz_log(value) for value in x])
    unit = eps * 2.0 ** np.floor(np.log2(np.maximum(np.abs(exact), 0.5).astype(float)))
    assert np.abs((logarithm - exact) / unit).max() < 1.0
    assert runtime.code.pz_log(1.0) == 0.0
