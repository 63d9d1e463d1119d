"""Frequency grids and responses, against discrete Fourier sums."""

import numpy as np
import pytest

from piezoid.numerics.polynomial import decibel, grid_Hz, response

RATE_Hz = 20e3


def test_the_grid_increases_from_its_start_to_just_below_nyquist():
    grid = grid_Hz(RATE_Hz, lowest_Hz=0.5, count=300)
    assert (np.diff(grid) > 0).all()
    assert grid[0] == pytest.approx(0.5)
    assert 0.4998 * RATE_Hz < grid[-1] < 0.5 * RATE_Hz
    assert 290 <= len(grid) <= 300


def test_the_response_is_the_fourier_sum_of_the_impulse_response():
    B, A = np.array([0.0, 0.2, 0.1]), np.array([1.0, -1.2, 0.5])
    h = np.zeros(400)  # the poles' 0.7^400 is below rounding
    for k in range(len(h)):
        h[k] = sum(B[j] for j in range(3) if j == k)
        h[k] -= sum(A[j] * h[k - j] for j in (1, 2) if k >= j)
    f = np.array([1.0, 500.0, 7000.0])
    sums = [(h * np.exp(-2j * np.pi * x / RATE_Hz * np.arange(len(h)))).sum() for x in f]
    np.testing.assert_allclose(response(B, A, f, RATE_Hz), sums, rtol=1e-12)


def test_twice_as_much_is_six_decibels_and_zero_is_minus_infinity():
    assert decibel(2.0) == pytest.approx(6.0206, abs=1e-4)
    assert decibel(0.0) == -np.inf
