"""Conformal quantiles cover new draws with their stated probability."""

import numpy as np
import pytest

from piezoid.verification.bounds import DRAWN, conformal_quantile

TRIALS = 4000


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_a_conformal_quantile_covers_the_next_draw_with_its_probability(rng, probability):
    draws = np.exp(rng.standard_normal((TRIALS, DRAWN + 1)))
    coverage = np.mean([row[-1] <= conformal_quantile(row[:-1], probability) for row in draws])
    rank = np.ceil((DRAWN + 1) * probability)
    standard_error = np.sqrt(probability * (1.0 - probability) / TRIALS)
    assert rank / (DRAWN + 1) == pytest.approx(coverage, abs=4 * standard_error)
    assert coverage > probability - 4 * standard_error


def test_too_few_draws_give_an_infinite_bound():
    assert conformal_quantile([1.0] * 18, 0.95) == np.inf
    assert conformal_quantile([1.0] * 19, 0.95) == 1.0
