"""Ridge regression by families estimates the variance of each family and the noise."""

import numpy as np
import pytest

from piezoid.numerics.family_ridge import FamilyRidge, Moments


def moments_of(x: np.ndarray, y: np.ndarray) -> Moments:
    return Moments(gram=x.T @ x, moment=x.T @ y, square=float(y @ y), count=len(y))


def test_variances_and_noise_of_simulated_data_are_estimated():
    rng = np.random.default_rng(1)
    family = np.repeat([0, 1, 2], [40, 40, 1])
    x = rng.standard_normal((4000, 81))
    w = np.concatenate([rng.standard_normal(40), np.zeros(40), [100.0]])
    y = x @ w + 0.1 * rng.standard_normal(4000)
    ridge = FamilyRidge(family=family, variance=np.array([10.0, 10.0, np.inf]), noise=1.0)
    ridge, mean, parameters = ridge.maximised(moments_of(x, y), ceiling=np.full(3, np.inf))
    assert ridge.noise == pytest.approx(0.01, rel=0.1)
    assert ridge.variance[0] == pytest.approx(np.mean(w[:40] ** 2), rel=0.05)
    assert ridge.variance[1] < 1e-4
    assert np.isinf(ridge.variance[2])
    assert np.abs(mean - w).max() < 0.01
    assert 41.0 < parameters < 60.0


def test_a_variance_keeps_its_upper_limit():
    rng = np.random.default_rng(2)
    x = rng.standard_normal((500, 5))
    y = x @ np.full(5, 30.0) + rng.standard_normal(500)
    ridge = FamilyRidge(family=np.zeros(5, dtype=np.intp), variance=np.ones(1), noise=1.0)
    ridge, _, _ = ridge.maximised(moments_of(x, y), ceiling=np.array([4.0]))
    assert ridge.variance[0] == 4.0
