"""Remarks state the weaknesses of a fit."""

from dataclasses import replace

import pytest

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.estimate import remarks_on
from piezoid.identification.hysteresis.pieces import Piece, Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.quality import OTHER_RECORDINGS
from tests.identification.hysteresis.stages import decaying, recording
from tests.identification.hysteresis.test_parts import stage

DECLARED = Rig(amplifier_bandwidth_Hz=4000.0)
SHAPE = Shape(plays=2, below=0, above=0)
SETTINGS = Settings(longest_lag_s=0.02, follow_zero=False)


def pieces(count: int) -> tuple[Piece, ...]:
    """Return pieces of this number of recordings with different noise."""
    drive = decaying(10, per_unit=10)
    recordings = [recording(drive, stage(drive, seed), f"{seed}.csv") for seed in range(count)]
    return pieces_of(recordings, "x", scales_of(recordings, "x"), Rig())


@pytest.mark.parametrize(("iterations", "gap"), [(30, 0.0), (1, 1.0)])
def test_a_start_far_from_its_optimum_has_a_remark(iterations, gap):
    fitted = search(pieces(1), SHAPE, replace(SETTINGS, iterations=iterations))
    assert fitted.converged is (iterations == 30)
    remarks = remarks_on(replace(fitted, kkt_gap=gap), OTHER_RECORDINGS, Rig())
    assert any("optimal only to" in remark for remark in remarks) is (gap > 0.0)


def test_a_lag_of_zero_names_the_declared_poles():
    shape = replace(SHAPE, lag="delay")
    fitted = search(pieces(1), shape, Settings(longest_lag_s=0.02, iterations=1))
    theta = fitted.theta.copy()
    theta[fitted.task.coordinates.slices["lag"]] = 0.0
    leading = replace(fitted, theta=theta)
    texts = [" ".join(remarks_on(leading, OTHER_RECORDINGS, rig)) for rig in (Rig(), DECLARED)]
    assert "may lead the drive" in texts[0]
    assert "the declared poles (4.00 kHz) delay at least as much" in texts[1]
