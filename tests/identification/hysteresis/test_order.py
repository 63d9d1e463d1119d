"""When a trial of a shape may end early."""

import math

import pytest

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.order_selection import fit_trial
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


@pytest.mark.parametrize("count", [1, 3])
def test_a_trial_ends_as_soon_as_it_misses_its_limit_and_is_else_the_same(count: int) -> None:
    free = fit_trial(pieces(count), SHAPE, SETTINGS, max_rms=math.inf)
    assert free is not None
    just = fit_trial(pieces(count), SHAPE, SETTINGS, max_rms=free.held_out_rms)
    assert just is not None
    assert just.residual.tobytes() == free.residual.tobytes()
    within = math.nextafter(free.held_out_rms, 0.0)
    assert fit_trial(pieces(count), SHAPE, SETTINGS, max_rms=within) is None
