"""Exact sampling: printed poles, and delays against fine simulation of the same system."""

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import response, state_space_response
from piezoid.numerics.zero_order_hold import fraction, hold_matrices, realised, sample

PERIOD_s = 50e-6
ROUNDING = 1e-13


def oscillator(frequency_Hz: float, damping: float) -> tuple[Array, Array, Array]:
    w = 2 * np.pi * frequency_Hz
    A = np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]])
    return A, np.array([0.0, w**2]), np.array([1.0, 0.0])


def simulated(A: Array, B: Array, C: Array, u: Array, delay_s: float, fine: int) -> Array:
    """Step the continuous system in ``fine`` pieces of each period; the delay is whole pieces."""
    step, drive = hold_matrices(A, B, PERIOD_s / fine)
    late = round(delay_s / PERIOD_s * fine)
    pieces = np.concatenate([np.zeros(late), np.repeat(u, fine)])
    x, y = np.zeros(len(A)), np.empty(len(u))
    for k in range(len(u) * fine):
        if k % fine == 0:
            y[k // fine] = C @ x
        x = step @ x + drive * pieces[k]
    return y


@pytest.mark.parametrize(
    ("frequency_Hz", "pole"),
    [(630, 0.820435), (4e3, 0.284610), (8.5e3, 0.069228), (20e3, 0.00186744)],
)
def test_first_order_poles_are_the_exponentials(frequency_Hz, pole):
    w = 2 * np.pi * frequency_Hz
    system = sample(np.array([[-w]]), np.array([w]), np.ones(1), PERIOD_s)
    assert system.A[0, 0] == pytest.approx(pole, abs=6e-7)
    assert system.taps[0, 0] == pytest.approx(1 - system.A[0, 0], rel=ROUNDING)


@pytest.mark.parametrize(
    ("damping", "denominator", "numerator"),
    [
        (0.02, (1, -1.95322384, 0.99211444), (0, 0.01947099, 0.01941961)),
        (0.05, (1, -1.94174164, 0.98040254), (0, 0.01939430, 0.01926660)),
        (0.10, (1, -1.92290707, 0.96118915), (0, 0.01926748, 0.01901460)),
    ],
)
def test_a_mode_at_630_hertz_has_the_printed_coefficients(damping, denominator, numerator):
    B, A = fraction(sample(*oscillator(630.0, damping), PERIOD_s))
    np.testing.assert_allclose(A, denominator, atol=6e-9)
    np.testing.assert_allclose(B, numerator, atol=6e-9)


@pytest.mark.parametrize("samples", [0.0, 0.25, 0.6, 1.0, 1.4, 3.2])
def test_any_delay_agrees_with_fine_simulation(samples, rng):
    A, B, C = oscillator(900.0, 0.1)
    u = rng.normal(size=60)
    system = sample(A, B, C, PERIOD_s, samples * PERIOD_s)
    transition, drive, output = realised(system)
    x, y = np.zeros(len(transition)), np.empty(len(u))
    for k, value in enumerate(u):
        y[k] = output @ x
        x = transition @ x + drive * value
    reference = simulated(A, B, C, u, samples * PERIOD_s, 20)
    np.testing.assert_allclose(y, reference, atol=1e-11)


@pytest.mark.parametrize("samples", [0.0, 0.4, 2.7])
def test_fraction_and_state_space_are_the_same_plant(samples):
    system = sample(*oscillator(630.0, 0.05), PERIOD_s, samples * PERIOD_s)
    B, A = fraction(system)
    f = np.geomspace(1.0, 9900.0, 60)
    np.testing.assert_allclose(
        response(B, A, f, 20e3), state_space_response(*realised(system), f, 20e3), rtol=1e-9
    )
    assert len(A) == 3
    assert (B[: 1 + int(samples)] == 0.0).all()


def test_holding_twice_is_holding_once_for_twice_as_long():
    A, B, _ = oscillator(630.0, 0.05)
    once, drive = hold_matrices(A, B, PERIOD_s)
    twice, both = hold_matrices(A, B, 2 * PERIOD_s)
    np.testing.assert_allclose(once @ once, twice, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(once @ drive + drive, both, rtol=1e-12)
