"""Each effect has its requested size, is absent at zero, and cites its source."""

import inspect

import numpy as np
import pytest

from piezoid_datasets.virtual_lab.campaign import change_m, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from tests.datasets.campaigns import EVERYTHING, campaign, pairs

NAMES = (
    "creep",
    "thermal_drift",
    "rate_dependence",
    "resonance",
    "delay",
    "lag",
    "cross_coupling",
    "mains_interference",
    "sensor_periodic_error",
    "amplifier_saturation",
    "slew_limit",
    "gain_change",
    "quantisation",
    "timestamp_fault",
    "outliers",
    "initial_state",
    "asymmetry",
    "non_congruence",
)
# Delays and slips are whole rows and memories are drawn; other sizes are within a few percent.
MAX_RATIO = 1.35


def test_the_effects_are_those_of_the_table_and_cite_their_source():
    assert sorted(effect.name for effect in EFFECTS) == sorted(NAMES)
    for effect in EFFECTS:
        assert "\nSource: " in (inspect.getdoc(effect.install) or "")
        assert set(effect.shown_by) <= set(EVERYTHING)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_has_about_the_requested_size(name):
    effect = campaign(4, name).answer.effects[0]
    assert 1.0 / MAX_RATIO < effect.measured_percent / effect.asked_percent < MAX_RATIO
    changes = [change_m(*rows) for rows in pairs(4, name)]
    largest = max(effect.measure.of(change) for change in changes)
    stroke_m = campaign(4).rig.stroke_m
    assert abs(100.0 * largest / stroke_m - effect.measured_percent) < 1e-9


def test_an_effect_of_size_zero_changes_nothing():
    sizes = ({name: 0.0 for name in NAMES}, {})
    silent, sound = (draw_campaign(4, effects=e, plans=("check", "other_axis")) for e in sizes)
    for rows, expected in zip(silent.recordings, sound.recordings, strict=True):
        assert np.array_equal(rows.displacement_m, expected.displacement_m)
    assert silent.answer.effects == ()
