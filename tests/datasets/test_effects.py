"""Each effect is there at the size that was asked for, absent at zero, and told in its file."""

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
# Delays and slips come in whole rows, past memories from a draw; the rest is within some percent.
ABOUT = 1.35


def test_the_effects_are_those_of_the_table_and_tell_their_physics_and_source() -> None:
    assert sorted(effect.name for effect in EFFECTS) == sorted(NAMES)
    for effect in EFFECTS:
        assert "\nSource: " in (inspect.getdoc(effect.install) or "")
        assert set(effect.shown_by) <= set(EVERYTHING)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_changes_the_reading_by_about_the_size_it_was_asked_for(name: str) -> None:
    found = campaign(4, name).answer.effects[0]
    assert 1.0 / ABOUT < found.measured_percent / found.asked_percent < ABOUT
    changes = [change_m(*both) for both in pairs(4, name)]
    largest = max(found.measure.of(change) for change in changes)
    stroke_m = campaign(4).rig.stroke_m
    assert abs(100.0 * largest / stroke_m - found.measured_percent) < 1e-9


def test_an_effect_of_size_zero_is_silent() -> None:
    sizes = ({name: 0.0 for name in NAMES}, {})
    silent, sound = (draw_campaign(4, effects=e, plans=("check", "other_axis")) for e in sizes)
    for one, other in zip(silent.recordings, sound.recordings, strict=True):
        assert np.array_equal(one.displacement_m, other.displacement_m)
    assert silent.answer.effects == ()
