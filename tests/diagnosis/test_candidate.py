"""What counts as evidence: how much, how sure, and how much better than a placebo."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import CrossValidated
from piezoid.diagnosis.candidate import exceeds_structure
from piezoid.diagnosis.effects import (
    creep,
    initial_state,
    resonance,
    thermal_drift,
)

from .leaving import candidate_of, view_with

BLOCKS = 40
NOISY = view_with(0.0)  # leaves nothing but noise
BENT = view_with(3.0)  # leaves three times as much that is none


def held(*, rms: float = 1.0, gain: float = 0.5, z: float = 6.0, loss=None) -> CrossValidated:
    return CrossValidated(
        gain=gain,
        z=z,
        coefficient=np.ones(1),
        spread=np.zeros(1),
        loss=np.ones(BLOCKS) if loss is None else loss,
        rms=rms,
    )


def test_an_initial_state_has_a_name_where_it_takes_a_quarter_of_the_error_however_sure_it_is():
    for gain, named in ((0.26, True), (0.24, False)):
        found = candidate_of(
            initial_state.EFFECT, held(gain=gain, z=20.0), without=NOISY, view=NOISY
        )
        assert found.is_significant is named


@pytest.mark.parametrize(("of_placebo", "speaks"), [(0.25, True), (0.45, False)])
def test_an_effect_beats_its_placebo_by_far(of_placebo, speaks):
    one = candidate_of(
        creep.EFFECT, held(), placebo=held(gain=of_placebo), without=BENT, view=NOISY
    )
    assert one.is_significant is speaks


@pytest.mark.parametrize(
    ("times", "uneven", "speaks"),
    [(1.5, 0.0, True), (1.02, 0.0, False), (1.5, 9.0, False)],
    ids=["clearly", "hardly", "in some blocks"],
)
def test_an_effect_that_leaves_its_placebo_no_room_leaves_clearly_less(times, uneven, speaks):
    """No gain is 1.6 times one of 0.7: what counts is the rms above the noise, and blocks."""
    rms = 3.0 * NOISY.noise
    loss = 2.0 + uneven * np.where(np.arange(BLOCKS) % 2, 1.0, -1.0)
    own, others = held(gain=0.8, rms=rms), held(gain=0.7, rms=times * rms, loss=loss)
    one = candidate_of(creep.EFFECT, own, placebo=others, without=BENT, view=NOISY)
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


def test_the_strength_of_evidence_is_its_rms_over_that_of_the_structure():
    bent, quiet = (
        candidate_of(creep.EFFECT, held(), without=view, view=view) for view in (BENT, NOISY)
    )
    structure = np.sqrt(BENT.rms**2 - BENT.noise**2)
    assert structure == pytest.approx(3.0 * NOISY.rms, rel=0.1)
    assert bent.strength == pytest.approx(0.02 / structure)
    # no structure is left there, but what the noise may be wrong by
    assert quiet.strength == pytest.approx(0.02 / (NOISY.noise * 0.03**0.5))


@pytest.mark.parametrize(("view", "named"), [(NOISY, True), (BENT, False)], ids=["noise", "bent"])
def test_what_is_sure_and_small_beside_what_is_left_is_significant_and_has_no_name(view, named):
    """Half of the structure is added, or any part of none."""
    share = 0.25 * float(np.sqrt(BENT.rms**2 - BENT.noise**2))
    one = candidate_of(thermal_drift.EFFECT, held(z=20.0), without=view, view=view, share=share)
    assert one.is_significant
    assert one.has_a_name is named
    larger = replace(one, share=2.0 * share)
    assert larger.has_a_name
