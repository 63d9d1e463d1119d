"""What counts as evidence: how much, how sure, and how much better than a placebo."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.diagnosis.candidate import Candidate, exceeds_structure
from piezoid.diagnosis.effects import (
    creep,
    initial_state,
    resonance,
    thermal_drift,
)
from piezoid.diagnosis.folds import CrossValidated

BLOCKS = 40


def held(*, rms: float = 1.0, gain: float = 0.5, z: float = 6.0, loss=None) -> CrossValidated:
    return CrossValidated(
        gain=gain,
        z=z,
        coefficient=np.ones(1),
        spread=np.zeros(1),
        loss=np.ones(BLOCKS) if loss is None else loss,
        rms=rms,
    )


def judged(
    effect,
    mine: CrossValidated,
    placebo: CrossValidated | None = None,
    *,
    left: float,
    noise: float,
) -> Candidate:
    return Candidate(
        selected=SimpleNamespace(effect=effect),
        cv=mine,
        placebo=placebo,
        share=0.01,
        physical=True,
        without=SimpleNamespace(rms=left, noise=noise),
        view=SimpleNamespace(rms=mine.rms, noise=noise),
    )


def test_an_initial_state_has_a_name_where_it_takes_a_quarter_of_the_error_however_sure_it_is():
    for gain, named in ((0.26, True), (0.24, False)):
        found = judged(initial_state.EFFECT, held(gain=gain, z=20.0), left=1.0, noise=1.0)
        assert found.is_significant is named


@pytest.mark.parametrize(("of_placebo", "speaks"), [(0.25, True), (0.45, False)])
def test_an_effect_beats_its_placebo_by_far(of_placebo, speaks):
    one = judged(creep.EFFECT, held(gain=0.5), held(gain=of_placebo), left=2.0, noise=0.0)
    assert one.is_significant is speaks


def test_only_causes_that_look_like_a_structure_hold_it_back():
    assert creep.EFFECT.resembles(initial_state.EFFECT)
    assert not resonance.EFFECT.resembles(initial_state.EFFECT)


@pytest.mark.parametrize(
    ("share", "rms", "noise", "larger"),
    [
        (0.010, 0.020, 0.020, True),  # nothing but noise is left
        (0.010, 0.019, 0.020, True),
        (0.010, 0.025, 0.020, True),  # 0.015 of half the stroke is structure
        (0.010, 0.033, 0.020, False),  # 0.026
        (0.001, 0.020, 0.000, False),
    ],
)
def test_an_effect_is_larger_than_the_structure_that_is_left_or_has_no_name(
    share, rms, noise, larger
):
    assert exceeds_structure(share, rms, noise) is larger


@pytest.mark.parametrize(
    ("rms", "noise", "strength"),
    [
        (0.025, 0.020, 0.02 / 0.015),  # the structure that is left, of half the stroke
        (0.020, 0.020, 0.02 / (0.020 * 0.03**0.5)),  # none, but what the noise may be wrong by
    ],
)
def test_the_strength_of_evidence_is_its_rms_over_that_of_the_structure(rms, noise, strength):
    found = judged(creep.EFFECT, held(rms=rms), left=1.0, noise=noise)
    assert found.strength == pytest.approx(strength)


@pytest.mark.parametrize(("noise", "named"), [(1.0, True), (0.9999, False)])
def test_what_is_sure_and_small_beside_what_is_left_is_significant_and_has_no_name(noise, named):
    """Of half the stroke 0.02 is added, and 0.014 of structure is left or none."""
    found = replace(
        judged(thermal_drift.EFFECT, held(gain=0.5, z=20.0), left=1.0, noise=noise), share=0.001
    )
    assert found.is_significant
    assert found.has_a_name is named
