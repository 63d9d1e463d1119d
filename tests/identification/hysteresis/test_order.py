"""Which of several shapes is taken, and when a trial may end early."""

import math
from functools import cache

import pytest

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.order_selection import Trial, fit_trial
from piezoid.identification.hysteresis.pieces import Piece, Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings
from tests.identification.hysteresis.stages import decaying, recording
from tests.identification.hysteresis.test_parts import stage

SHAPE = Shape(plays=2, below=0, above=0)
SETTINGS = Settings(longest_lag_s=0.02, follow_zero=False)


def pieces(count: int) -> tuple[Piece, ...]:
    """Cut so many recordings of one stage, each of its own noise."""
    drive = decaying(10, per_unit=10)
    made = [recording(drive, stage(drive, seed), f"{seed}.csv") for seed in range(count)]
    return pieces_of(made, "x", scales_of(made, "x"), Rig())


@cache
def whole(count: int) -> Trial:
    """Try the shape on every fold."""
    found = fit_trial(pieces(count), SHAPE, SETTINGS, max_rms=math.inf)
    assert found is not None
    return found


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_trial_within_its_limit_is_the_one_without_a_limit(count: int) -> None:
    free = whole(count)
    just = fit_trial(pieces(count), SHAPE, SETTINGS, max_rms=free.held_out_rms)
    assert just is not None
    assert just.residual.tobytes() == free.residual.tobytes()
    assert just.lag_s == free.lag_s


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_trial_beyond_its_limit_is_none_however_little_it_misses(count: int) -> None:
    within = math.nextafter(whole(count).held_out_rms, 0.0)
    assert fit_trial(pieces(count), SHAPE, SETTINGS, max_rms=within) is None
