"""Quantiles against published tables and SciPy's distributions."""

import numpy as np
import pytest
from scipy import stats

from piezoid.numerics.robust import normal_quantile, student_quantile

PROBABILITIES = np.array([1e-9, 0.025, 0.5, 0.8, 0.975, 0.9995])


@pytest.mark.parametrize(
    ("freedom", "value"), [(1, 12.706), (5, 2.571), (23, 2.069), (120, 1.980), (np.inf, 1.960)]
)
def test_the_factors_of_95_per_cent_are_those_of_every_table(freedom, value) -> None:
    assert student_quantile(0.975, freedom) == pytest.approx(value, abs=6e-4)


def test_quantiles_are_those_of_scipy_for_every_freedom_at_once() -> None:
    np.testing.assert_allclose(normal_quantile(PROBABILITIES), stats.norm.ppf(PROBABILITIES))
    freedom = np.array([0.7, 2.2, 9.0, 400.0, np.inf, 3.0])
    expected = stats.t.ppf(PROBABILITIES, freedom)
    np.testing.assert_allclose(student_quantile(PROBABILITIES, freedom), expected, rtol=1e-9)
