"""Linear systems: exact sampling, frequency response and fractions in q^-1."""

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.operators.linear import (
    ContinuousSystem,
    DiscreteSystem,
    butterworth,
    cascade,
    first_order,
    resonance,
    sample,
    sampled_fractions,
)

RATE_HZ = 20_000.0
ROUNDING = 1e-10  # products of a few dozen numbers near one


def fraction(system: ContinuousSystem) -> tuple[Array, Array]:
    """Return B and A in q^-1 of a sampled path, A[0] = 1; the delay is leading zeros of B."""
    sampled = sample(system, RATE_HZ)
    A = np.poly(np.exp(np.linalg.eigvals(system.A) / RATE_HZ)).real
    delay_samples = (len(sampled.A) - len(system.A)) // system.B.shape[1]
    terms = len(A) + delay_samples
    return np.convolve(sampled.impulse_response(terms)[:, 0, 0], A)[:terms], A


@pytest.mark.parametrize(
    ("frequency_Hz", "pole"),
    [(630, 0.820435), (4000, 0.284610), (8500, 0.069228), (20_000, 0.00186744)],
)
def test_a_lag_becomes_its_known_discrete_pole(frequency_Hz, pole):
    B, A = fraction(first_order(frequency_Hz))
    np.testing.assert_allclose(A, [1, -pole], atol=1e-6)
    np.testing.assert_allclose(B, [0, 1 - pole], atol=1e-6)


@pytest.mark.parametrize(
    ("damping", "den", "num"),
    [
        (0.02, (1, -1.95322384, 0.99211444), (0.01947099, 0.01941961)),
        (0.05, (1, -1.94174164, 0.98040254), (0.01939430, 0.01926660)),
        (0.10, (1, -1.92290707, 0.96118915), (0.01926748, 0.01901460)),
    ],
)
def test_a_mode_of_630_hertz_becomes_its_known_fraction(damping, den, num):
    B, A = fraction(resonance(630, damping))
    np.testing.assert_allclose(A, den, atol=6e-9)
    np.testing.assert_allclose(B, (0, *num), atol=6e-9)


@pytest.mark.parametrize("delay_samples", [0.0, 0.3, 1.0, 53.75])
@pytest.mark.parametrize("damping", [0.02, 1.0, 3.0])
@pytest.mark.parametrize("lags_Hz", [[], [4000], [4000, 4000]], ids=["none", "one", "two alike"])
def test_the_sampled_response_from_poles_equals_that_of_the_states(
    delay_samples, damping, lags_Hz
):
    mode, delay_s = resonance(630, damping), delay_samples / RATE_HZ
    delayed_mode = ContinuousSystem(A=mode.A, B=mode.B, C=mode.C, D=mode.D, delay_s=delay_s)
    chain, frequency_Hz = (
        cascade(*map(first_order, lags_Hz), delayed_mode),
        np.linspace(10, 9900, 50),
    )
    w, filters = 2 * np.pi * 630, 2 * np.pi * np.array(lags_Hz)
    pole = [*(w * (-damping + np.array([1, -1]) * np.sqrt(damping**2 - 1 + 0j))), *-filters]
    response = sampled_fractions(
        np.array([np.prod(filters) * w**2]),
        np.array([pole]),
        np.array([delay_s]),
        RATE_HZ,
        frequency_Hz,
    )
    has_equal_poles = damping == 1.0 or len(lags_Hz) == 2
    np.testing.assert_allclose(
        response[0],
        sample(chain, RATE_HZ).response(frequency_Hz)[:, 0, 0],
        atol=1e-9 if has_equal_poles else ROUNDING,
    )


@pytest.mark.parametrize("delay_samples", [0.0, 0.3, 2.0])
def test_a_pure_delay_has_its_sampled_response(delay_samples):
    empty = np.zeros((0, 0))
    direct = ContinuousSystem(
        A=empty, B=empty.T.reshape(0, 1), C=empty.reshape(1, 0), D=np.ones((1, 1)),
        delay_s=delay_samples / RATE_HZ,
    )  # fmt: skip
    frequency_Hz = np.linspace(10, 9900, 50)
    response = sampled_fractions(
        np.ones(1), np.zeros((1, 0), complex), np.array([direct.delay_s]), RATE_HZ,
        frequency_Hz,
    )  # fmt: skip
    expected = sample(direct, RATE_HZ).response(frequency_Hz)
    np.testing.assert_allclose(response[0], expected[:, 0, 0], atol=ROUNDING)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_butterworth_filter_is_flat_and_falls_to_half_the_power_at_its_corner(order):
    ratio = np.array([0.0, 0.1, 1.0, 3.0])
    gain = np.abs(butterworth(order, 1000).response(1000 * ratio)[:, 0, 0])
    np.testing.assert_allclose(gain, 1 / np.sqrt(1 + ratio ** (2 * order)), rtol=1e-12)


def test_a_matrix_of_the_wrong_shape_is_named():
    with pytest.raises(ValueError, match="B has shape"):
        DiscreteSystem(
            A=np.eye(2), B=np.ones((1, 1)), C=np.ones((1, 2)), D=np.zeros((1, 1)), interval_s=1.0
        )


@pytest.mark.parametrize("interval_s", [0.0, -1e-3, np.nan, np.inf])
def test_an_invalid_sampling_interval_is_named(interval_s):
    unit = np.ones((1, 1))
    with pytest.raises(ValueError, match="interval_s is"):
        DiscreteSystem(A=unit, B=unit, C=unit, D=unit, interval_s=interval_s)
