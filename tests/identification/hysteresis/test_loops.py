"""Loops seen without a model: between their branches, as wide, as quiet as their samples allow."""

import numpy as np
import pytest

from piezoid.identification.hysteresis.applicability import POINTS, loops_of
from piezoid.numerics.arrays import Array
from tests.identification.hysteresis.stages import play_sum, through


def looped(levels: list[float], per_unit: int) -> tuple[Array, Array]:
    """A play of half-width 0.3 and half the weight beside the drive itself."""
    drive = through(levels, per_unit)
    return drive, play_sum(drive, np.array([0.0, 0.3]), np.array([1.0, 0.5]), np.full(2, drive[0]))


def test_a_loop_is_as_wide_as_its_branches_are_apart() -> None:
    drive, response = looped([-1.0, 1.0] * 3, 100)
    for loop in loops_of(drive, response, 0.01)[1:]:
        middle = np.abs(loop.drive) < 0.3
        np.testing.assert_allclose(loop.opening[middle], 0.5 * 2 * 0.3, atol=0.01)
        assert loop.span == pytest.approx(2.0, abs=0.02)


def test_a_branch_is_as_quiet_at_its_ends_as_between() -> None:
    drive, response = looped([0.0, -1.0, 1.0, -1.0, 0.0], 1000)
    zigzag = 0.1 * (-1.0) ** np.arange(len(drive))
    (loop,), (still,) = (loops_of(drive, y, 0.01) for y in (response + zigzag, response))
    assert len(loop.drive) == POINTS
    few = 2000 / (POINTS + 1) - 1  # samples around each point, of which pairs cancel
    np.testing.assert_allclose(loop.rise, still.rise, atol=0.1 / few)
    np.testing.assert_allclose(loop.opening, still.opening, atol=2 * 0.1 / few)
