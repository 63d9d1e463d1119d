"""Exact sampling with delays, against a fine simulation of the same system."""

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import response
from piezoid.numerics.zero_order_hold import fraction, hold_matrices, realised, sample
from piezoid.operators.linear import DiscreteSystem

PERIOD_s = 50e-6


def oscillator(frequency_Hz: float, damping: float) -> tuple[Array, Array, Array]:
    w = 2 * np.pi * frequency_Hz
    A = np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]])
    return A, np.array([0.0, w**2]), np.array([1.0, 0.0])


def simulated(A: Array, B: Array, C: Array, u: Array, delay_s: float, fine: int) -> Array:
    """Simulate the system in ``fine`` substeps of each period; the delay is whole substeps."""
    step, drive = hold_matrices(A, B, PERIOD_s / fine)
    delay = round(delay_s / PERIOD_s * fine)
    pieces = np.concatenate([np.zeros(delay), np.repeat(u, fine)])
    x, y = np.zeros(len(A)), np.empty(len(u))
    for k in range(len(u) * fine):
        if k % fine == 0:
            y[k // fine] = C @ x
        x = step @ x + drive * pieces[k]
    return y


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
    states, drive, output = realised(system)
    state_space = DiscreteSystem(
        A=states, B=drive[:, None], C=output[None], D=np.zeros((1, 1)), interval_s=PERIOD_s
    )
    np.testing.assert_allclose(
        response(B, A, f, 20e3), state_space.response(f)[:, 0, 0], rtol=1e-9
    )
    assert len(A) == 3
    assert (B[: 1 + int(samples)] == 0.0).all()
