"""What counts as one draw: a sample with its neighbours, or a part of the recording."""

import numpy as np
import pytest

from piezoid.identification.dynamics.hammerstein import (
    NEIGHBOURS,
    PARTS,
    STUDENT,
    over_neighbours,
    over_parts,
)


def test_neighbours_count_with_falling_weight(rng: np.random.Generator) -> None:
    scores = rng.standard_normal((2, 500))
    expected = scores @ scores.T
    for lag in range(1, NEIGHBOURS):
        both = scores[:, lag:] @ scores[:, :-lag].T
        expected += (1.0 - lag / NEIGHBOURS) * (both + both.T)
    np.testing.assert_allclose(over_neighbours(scores), expected)


def test_independent_scores_give_both_sums_their_number(rng: np.random.Generator) -> None:
    """Twelve parts of 200 recordings: their mean is known to 3 %."""
    draws = [rng.standard_normal((1, 1200)) for _ in range(200)]
    near = np.mean([over_neighbours(scores)[0, 0] for scores in draws])
    far = np.mean([over_parts(scores)[0, 0] for scores in draws])
    assert near == pytest.approx(1200, rel=0.06)
    students = PARTS / (PARTS - 1) * (STUDENT / 1.96) ** 2
    assert far == pytest.approx(1200 * students, rel=0.12)


def test_what_repeats_from_cycle_to_cycle_is_seen_by_parts_alone() -> None:
    """A score of one sign for many cycles, then of the other, adds up over each stretch."""
    repeating = np.repeat([1.0, -1.0], 600)[None, :]
    assert over_parts(repeating)[0, 0] > 3.0 * over_neighbours(repeating)[0, 0]
