"""A campaign is determined by its seed; the stage does not depend on the effects."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.plans import PLANS
from piezoid_datasets.virtual_lab.truths import TRUTHS
from piezoid_datasets.virtual_lab.write import campaign_files


def names(campaign: Campaign) -> list[str]:
    return [rows.run.name for rows in campaign.recordings]


def test_the_same_seed_makes_the_same_bytes():
    hidden = {"outliers": None, "mains_interference": 0.2, "initial_state": None}
    files = [campaign_files(draw_campaign(11, effects=hidden)) for _ in range(2)]
    assert files[0] == files[1]


def test_another_seed_makes_another_stage():
    campaigns = [draw_campaign(seed, plans=("check",)) for seed in range(8)]
    assert len({campaign.rig.stroke_m for campaign in campaigns}) == len(campaigns)
    assert {campaign.answer.truth for campaign in campaigns} == {truth.name for truth in TRUTHS}


def test_the_stage_of_a_seed_does_not_depend_on_its_effects():
    plans = ("sweep", "staircase")
    sound = draw_campaign(5, plans=plans)
    faulty = draw_campaign(5, plans=plans, effects={"creep": 1e-9})
    for expected, rows in zip(sound.recordings, faulty.recordings, strict=True):
        assert np.array_equal(expected.voltage_V, rows.voltage_V)
        assert np.allclose(expected.noise_free_m, rows.noise_free_m, atol=1e-12)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: effect.name)
def test_a_campaign_has_three_to_six_recordings_and_shows_its_effect(effect):
    name = effect.name  # type: ignore[attr-defined]
    shown_by = effect.shown_by  # type: ignore[attr-defined]
    played = names(draw_campaign(0, effects={name: 1e-6}))
    assert 3 <= len(played) <= 6
    assert set(played) & set(shown_by)


def test_drawn_sizes_are_one_to_four_times_the_visible_size():
    visible = {effect.name: effect.visible_percent for effect in EFFECTS}
    times = []
    for seed in range(12):
        hidden = draw_campaign(seed, effects=["quantisation", "outliers"], plans=("check",))
        times += [e.asked_percent / visible[e.name] for e in hidden.answer.effects]
    assert min(times) >= 1.0
    assert max(times) <= 4.0
    assert max(times) / min(times) > 2.0


def test_every_effect_is_measured_with_the_others_present():
    hidden = {"creep": 0.8, "lag": 0.4, "gain_change": 1.0}
    answer = draw_campaign(6, effects=hidden).answer
    assert [e.name for e in answer.effects] == ["creep", "gain_change", "lag"]  # upstream first
    for effect in answer.effects:
        assert abs(effect.measured_percent / hidden[effect.name] - 1.0) < 0.2


def test_a_careless_lab_starts_from_another_memory():
    careful, careless = (draw_campaign(3, careless=c, plans=("sweep",)) for c in (False, True))
    change = careful.recordings[0].noise_free_m - careless.recordings[0].noise_free_m
    assert np.max(np.abs(change)) > 1e-4 * careful.rig.stroke_m
    assert careless.answer.careless


def test_readings_and_drives_keep_their_range():
    for seed in (0, 1):
        campaign = draw_campaign(seed, plans=[plan.name for plan in PLANS])
        reach_m = campaign.rig.converter_range_V[1] / campaign.rig.sensor_gain_V_per_m
        for rows in campaign.recordings:
            assert np.max(np.abs(rows.displacement_m)) < reach_m
            assert rows.voltage_V.min() >= campaign.rig.drive_min_V
            assert rows.voltage_V.max() <= campaign.rig.drive_max_V


def test_a_negative_size_is_refused():
    with pytest.raises(ValueError, match="must not be negative"):
        draw_campaign(1, effects={"creep": -0.1})


def test_a_new_plan_is_recorded_like_a_known_one():
    sweep = next(plan for plan in PLANS if plan.name == "sweep")
    plan = replace(sweep, name="mine", shape=lambda *_: (500.0, np.linspace(-1.0, 1.0, 700), {}))
    campaign = draw_campaign(5, plans=("check", plan))
    assert [rows.run.name for rows in campaign.recordings] == ["check", "mine"]
    assert len(campaign.recordings[1].voltage_V) == 700
