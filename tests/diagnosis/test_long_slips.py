"""No slip is longer than a tenth of its recording, whatever one that hardly moves tells."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effects import timestamp_fault
from piezoid.diagnosis.effects.timestamp_fault import slip_evidence
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.sample_slips import (
    Slip,
    delay_like_null,
    max_slip,
    refine_slip,
    strongest_slips,
)
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

from .play_stage import NOISE_m, STROKE_m, clean, moved, recording, slipped, view_with

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


def test_stretches_of_equal_speed_that_tell_of_too_long_a_slip_are_not_believed() -> None:
    """What was placed at 683 samples would be one of 939 of 9000, clear by all other signs."""
    view = view_of(recording("sweep"), wandering(154, 2.2, 0.03))
    null = delay_like_null(view)
    wanders = next(slip for slip in strongest_slips(view, null) if slip.track == 1)
    judged = slip_evidence(view, null, refine_slip(view, wanders))
    assert judged is not None
    told = round(judged.step)
    assert abs(judged.slip.samples) < max_slip(SAMPLES) < abs(told)
    long = refine_slip(view, replace(wanders, samples=told), has_length=True)
    asked = slip_evidence(view, null, long)
    assert asked is not None
    assert asked.is_significant
    assert timestamp_fault.EFFECT.fault.find(view) is None


@pytest.mark.parametrize("sign", [1, -1])
def test_a_slip_is_not_made_longer_than_may_be_where_it_is_placed(sign) -> None:
    view = view_with(walk=slipped(clean("walk")[2], 4100, sign * 960))
    slip = Slip(track=1, instant=4100, samples=sign * 850.0, gain=0.5)
    there = refine_slip(view, slip)
    assert sign * there.samples == max_slip(SAMPLES)
