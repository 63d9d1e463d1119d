"""Periods of repeating drives are located after rest and ramps."""

import numpy as np
import pytest

from piezoid.numerics.repetition import equal_cycles, find_repetition


@pytest.mark.parametrize(("first_count", "second_count"), [(0, 4), (3, 9), (9, 3)])
def test_the_longest_repetition_is_located(rng, first_count, second_count):
    period = rng.standard_normal(200)
    lead = np.concatenate([np.zeros(700), np.linspace(0.0, period[0])])
    signal = np.concatenate(
        [
            lead,
            np.tile(period, first_count),
            rng.standard_normal(90),
            np.tile(period, second_count),
        ]
    )
    repetition = find_repetition(signal)
    assert repetition is not None
    assert (repetition.period_samples, repetition.periods) == (200, max(first_count, second_count))
    start = len(lead) + (200 * first_count + 90 if second_count > first_count else 0)
    assert abs(repetition.first - start) <= 1
    np.testing.assert_allclose(
        repetition.last_periods(signal, 2)[:, 1], np.roll(period, start - repetition.first)
    )


def test_chirps_constant_and_decaying_drives_do_not_repeat():
    assert find_repetition(np.sin(np.linspace(0.0, 30.0, 5000) ** 2)) is None
    assert find_repetition(np.zeros(100)) is None
    turn = np.arange(4800) / 80.37
    shrinking = np.cos(2.0 * np.pi * turn) * (1.0 - 0.05 * turn / turn[-1])
    assert equal_cycles(np.cos(2.0 * np.pi * turn), fewest=8) is not None
    assert equal_cycles(shrinking, fewest=8) is None
