"""Drives that repeat: their period is found behind rest and ramps, and nothing else repeats."""

import numpy as np
import pytest

from piezoid.numerics.repetition import equal_cycles, find_repetition


@pytest.mark.parametrize(("before", "after"), [(0, 4), (3, 9), (9, 3)])
def test_the_longest_part_that_repeats_is_found(
    rng: np.random.Generator, before: int, after: int
) -> None:
    period = rng.standard_normal(200)
    lead = np.concatenate([np.zeros(700), np.linspace(0.0, period[0])])
    signal = np.concatenate(
        [lead, np.tile(period, before), rng.standard_normal(90), np.tile(period, after)]
    )
    found = find_repetition(signal)
    assert found is not None
    assert (found.period_samples, found.periods) == (200, max(before, after))
    first = len(lead) + (200 * before + 90 if after > before else 0)
    assert abs(found.first - first) <= 1
    np.testing.assert_allclose(
        found.last_periods(signal, 2)[:, 1], np.roll(period, first - found.first)
    )


def test_a_chirp_and_a_rest_never_repeat() -> None:
    assert find_repetition(np.sin(np.linspace(0.0, 30.0, 5000) ** 2)) is None
    assert find_repetition(np.zeros(100)) is None


def test_a_drive_that_shrinks_has_no_equal_cycles() -> None:
    turn = np.arange(4800) / 80.37
    shrinking = np.cos(2.0 * np.pi * turn) * (1.0 - 0.05 * turn / turn[-1])
    assert equal_cycles(np.cos(2.0 * np.pi * turn), fewest=8) is not None
    assert equal_cycles(shrinking, fewest=8) is None
