"""What is said to be probable is as probable as that."""

import numpy as np
import pytest

from piezoid.verification.bounds import DRAWN, conformal_quantile

TRIALS = 4000


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_the_next_number_of_a_kind_stays_below_as_often_as_it_says(rng, probability):
    drawn = np.exp(rng.standard_normal((TRIALS, DRAWN + 1)))
    held = np.mean([row[-1] <= conformal_quantile(row[:-1], probability) for row in drawn])
    place = np.ceil((DRAWN + 1) * probability)
    spread = np.sqrt(probability * (1.0 - probability) / TRIALS)
    assert place / (DRAWN + 1) == pytest.approx(held, abs=4 * spread)
    assert held > probability - 4 * spread


def test_too_few_numbers_bound_nothing():
    assert conformal_quantile([1.0] * 18, 0.95) == np.inf
    assert conformal_quantile([1.0] * 19, 0.95) == 1.0
