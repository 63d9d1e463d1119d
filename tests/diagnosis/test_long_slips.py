"""No slip is longer than a tenth of its recording, whatever one that hardly moves tells."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effects import timestamp_fault
from piezoid.diagnosis.slips import Slip, beside, longest, placed, strongest
from piezoid.diagnosis.view import View
from piezoid.records.lab import Lab

from .play_stage import NOISE_m, STROKE_m, clean, moved, recording, slipped, view_with

SAMPLES = 9000


@cache
def wandering_view(seed: int) -> View:
    """Return a view in which the last recording hardly moves and its reading wanders far."""
    chance = np.random.default_rng(seed)
    field = 0.3 + 0.01 * np.sin(2 * np.pi * 1.3 * np.arange(SAMPLES) / SAMPLES)
    wandered = 0.05 * np.cumsum(chance.normal(size=SAMPLES)) / np.sqrt(SAMPLES)
    reading_m = STROKE_m * (moved(field) + wandered) + chance.normal(0.0, NOISE_m, SAMPLES)
    recordings = [recording("sweep"), recording("walk"), recording("waves", reading_m, field)]
    return view_on(recordings, axis="x", lab=Lab())


@pytest.mark.parametrize("seed", [2, 7, 9])
def test_a_recording_that_hardly_moves_promises_no_slip_longer_than_may_be(seed) -> None:
    view = wandering_view(seed)
    slips = strongest(view, beside(view))
    assert slips
    for slip in slips:
        assert abs(slip.samples) <= longest(len(view.tracks[slip.track].drive))
    assert timestamp_fault.EFFECT.fault.find(view) is None


@pytest.mark.parametrize("times", [-2.0, 0.5])
def test_stretches_of_equal_speed_that_tell_of_a_slip_longer_than_may_be_are_not_believed(
    monkeypatch, times
) -> None:
    asked = []

    def told(_, __, slip):
        asked.append(slip)
        return SimpleNamespace(
            slip=replace(slip, samples=round(slip.samples)),
            step=times * SAMPLES,
            deviation=1.0,
            is_significant=lambda **_: False,
        )

    monkeypatch.setattr(timestamp_fault, "evidence_of", told)
    assert timestamp_fault.EFFECT.fault.find(wandering_view(2)) is None
    assert asked
    assert all(abs(slip.samples) < 0.5 * SAMPLES for slip in asked)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_slip_is_not_made_longer_than_may_be_where_it_is_placed(sign) -> None:
    view = view_with(walk=slipped(clean("walk")[2], 4100, sign * 960))
    slip = Slip(track=1, instant=4100, samples=sign * 850.0, gain=0.5)
    there = placed(view, slip)
    assert sign * there.samples == longest(SAMPLES)
