"""Sizes of causes are the laboratory's own numbers."""

import pytest

from piezoid.diagnosis.effects import amplifier_saturation
from piezoid.diagnosis.judgement import judged
from piezoid.diagnosis.refinement import begun, refined
from piezoid.diagnosis.screening import screen
from piezoid.diagnosis.sizes import size_of
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign

from .bench import recorded, view_of_recordings


def cut_off_percent(campaign: Campaign) -> float:
    """Return the larger part of the recorded commands' range that lies beyond a limit."""
    gain = campaign.rig.amplifier_gain_V_per_V
    low_V = min(gain * float(rows.run.command_V.min()) for rows in campaign.recordings)
    high_V = max(gain * float(rows.run.command_V.max()) for rows in campaign.recordings)
    (effect,) = campaign.answer.effects
    above_V = high_V - float(effect.numbers.get("high_V", high_V))
    below_V = float(effect.numbers.get("low_V", low_V)) - low_V
    return 100.0 * max(above_V, below_V) / (high_V - low_V)


@pytest.mark.parametrize("seed", [2, 3], ids=["above", "on both sides"])
def test_the_size_of_a_clip_is_the_part_of_the_drives_range_that_is_cut_off(seed) -> None:
    campaign = draw_campaign(
        seed, truth="preisach", effects=("amplifier_saturation",), plans=("sweep", "check")
    )
    view = view_of_recordings(*recorded(campaign))
    seen = screen(amplifier_saturation.EFFECT, view)
    start = begun(amplifier_saturation.EFFECT, seen.trial, float(seen.held.coefficient[0]))
    one, there = refined(start, view, [])
    cause = judged(one, there, view, seen=seen)
    size, true = size_of(cause), cut_off_percent(campaign)
    assert cause.speaks
    assert true > 1.0
    assert size.value == pytest.approx(true, rel=0.1)
    low, high = size.ci95
    assert 0.0 < low < true < high < 1.3 * true
