"""Free decay after a step: frequency and damping within their intervals."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.dynamics.ring import choose_ring, find_step, identify_ring
from piezoid.numerics.arrays import Array

RATE_HZ = 5000.0
TRUE_HZ = (965.0, 1720.0)
TRUE_DAMPING = (0.034, 0.03)


def decay_m(samples: int = 200) -> Array:
    time_s = np.arange(samples) / RATE_HZ
    w = 2 * np.pi * np.array(TRUE_HZ)
    zeta = np.array(TRUE_DAMPING)
    turn = np.outer(time_s, w * np.sqrt(1 - zeta**2)) + np.array([0.3, 1.0])
    rings = np.exp(-np.outer(time_s, zeta * w)) * np.cos(turn) @ [4e-6, 2e-6]
    return np.asarray(rings - 8e-6 + 6e-5 * time_s - 1e-4 * time_s**2)


def test_without_noise_frequency_and_damping_come_back() -> None:
    ring = identify_ring(decay_m(), RATE_HZ, start=0, samples=200, modes=2)
    np.testing.assert_allclose(ring.frequency_Hz, TRUE_HZ, rtol=1e-8)
    np.testing.assert_allclose(ring.damping, TRUE_DAMPING, rtol=1e-6)
    np.testing.assert_allclose(ring.amplitude_m, [4e-6, 2e-6], rtol=1e-6)


def test_intervals_hold_the_truth_as_often_as_they_say(rng: np.random.Generator) -> None:
    """At least 93 % of 4 parameters in 100 draws."""
    clean_m, inside = decay_m(), 0
    for _ in range(100):
        noisy_m = clean_m + 5e-8 * rng.standard_normal(200)
        ring = identify_ring(noisy_m, RATE_HZ, start=0, samples=200, modes=2)
        limits = np.concatenate([ring.frequency_interval_Hz, ring.damping_interval])
        exact = np.array([*TRUE_HZ, *TRUE_DAMPING])
        inside += int(((limits[:, 0] <= exact) & (exact <= limits[:, 1])).sum())
    assert inside >= 0.93 * 400


def test_the_number_of_rings_is_found(rng: np.random.Generator) -> None:
    noisy_m = decay_m() + 5e-8 * rng.standard_normal(200)
    ring = choose_ring(noisy_m, RATE_HZ, start=0, samples=200)
    assert len(ring.frequency_Hz) == 2
    assert ring.residual_rms_m == pytest.approx(5e-8, rel=0.15)
    assert abs(ring.residual_correlation) < 0.25


def test_noise_alone_is_no_ring(rng: np.random.Generator) -> None:
    with pytest.raises(IdentificationError):
        choose_ring(1e-9 * rng.standard_normal(60), RATE_HZ, start=0, samples=60)


def test_a_step_is_found_and_a_ramp_is_not_one() -> None:
    ramp_V = np.linspace(0, 1, 50)
    assert find_step(ramp_V + 80.0 * (np.arange(50) >= 20)) == 20
    with pytest.raises(ExcitationError, match="one step ten times larger"):
        find_step(ramp_V)


def test_a_recorded_actuator_rings_near_970_hertz(realdata: Path) -> None:
    """The drive steps at 3.257 s and moves on slowly; noise before it is 0.05 um."""
    table = np.genfromtxt(realdata / "actuator_150V" / "hysteresis_v_150_1hz.csv", delimiter=",")
    displacement_m, voltage_V = 1e-6 * table[:, 2], table[:, 3]
    step = find_step(voltage_V)
    ring = choose_ring(displacement_m, RATE_HZ, start=step + 10, samples=200)
    low_Hz, high_Hz = ring.frequency_interval_Hz[0]
    assert step / RATE_HZ == pytest.approx(3.257, abs=1e-3)
    assert 955 < low_Hz < ring.frequency_Hz[0] < high_Hz < 980
    assert high_Hz - low_Hz < 4
    assert ring.damping[0] == pytest.approx(0.033, abs=0.003)
    assert ring.residual_rms_m < 6e-8
