"""No slip is longer than a tenth of its recording, whatever one that hardly moves tells."""

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effects import timestamp_fault
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.sample_slips import delay_like_null, max_slip, strongest_slips
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

from .play_stage import NOISE_m, STROKE_m, moved, recording

SAMPLES = 9000


def wandering(seed: int, turns: float, far: float) -> Recording:
    """Return a recording that hardly moves, so many times to and fro, and whose reading wanders.

    far  of the stroke: the spread of where the reading ends
    """
    chance = np.random.default_rng(seed)
    field = 0.3 + 0.01 * np.sin(2 * np.pi * turns * np.arange(SAMPLES) / SAMPLES)
    wandered = far * np.cumsum(chance.normal(size=SAMPLES)) / np.sqrt(SAMPLES)
    reading_m = STROKE_m * (moved(field) + wandered) + chance.normal(0.0, NOISE_m, SAMPLES)
    return recording("waves", reading_m, field)


def view_of(*recordings: Recording) -> View:
    return view_on(recordings, axis="x", lab=Lab())


@pytest.mark.parametrize("seed", [2, 7, 9])
def test_a_recording_that_hardly_moves_promises_no_slip_longer_than_may_be(seed) -> None:
    view = view_of(recording("sweep"), recording("walk"), wandering(seed, 1.3, 0.05))
    slips = strongest_slips(view, delay_like_null(view))
    assert slips
    for slip in slips:
        assert abs(slip.samples) <= max_slip(len(view.tracks[slip.track].drive))
    assert timestamp_fault.EFFECT.fault.find(view) is None
