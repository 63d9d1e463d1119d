"""What a laboratory always does before it records leaves no unknown memory; what it forgot does.

The stage is a sum of plays that begins where we say, on parts of a healthy campaign's drives.
"""

import pytest

from piezoid.diagnosis.candidate import Candidate, structural_candidate
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import initial_state
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    is_shared_state_as_good,
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.residual_view import View, with_free_memory
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, recorded_zoo_stage, view_of_recordings
from .played import at_rest, cycled, cycled_the_other_way, forgotten, view_after


def structure_of(view: View) -> Candidate:
    """Judge the memory of recordings as a search does in which nothing else is found."""
    own = with_individual_initial_states(view, with_shared_initial_state(view))
    final = with_free_memory(own) if own.rms < OTHER_INITIAL_STATES * view.rms else view
    judgement = structural_candidate(initial_state.EFFECT, final)
    assert judgement is not None
    return judgement[1]


@pytest.mark.parametrize(
    "before",
    [
        (cycled,) * 3,
        (at_rest,) * 3,
        (cycled_the_other_way,) * 3,
        (cycled_the_other_way, None, None),
        (at_rest, None, None),
    ],
    ids=["cycled", "at rest", "the other way", "one after another", "from rest on"],
)
def test_what_a_laboratory_always_does_before_it_records_is_no_unknown_memory(before) -> None:
    view = view_after(*before)
    assert not structure_of(view).is_significant
    if before[0] is not cycled:
        # though the memory that is taken for granted at first is none of it
        assert (
            with_individual_initial_states(view, with_shared_initial_state(view)).rms
            < 0.6 * view.rms
        )


def test_one_recording_that_came_from_elsewhere_has_a_memory_that_nobody_recorded() -> None:
    structure = structure_of(view_after(cycled, forgotten, cycled))
    assert structure.is_significant
    assert structure.cv.gain > 2.0 * initial_state.EFFECT.minimum_gain


def test_a_ceramic_that_was_never_driven_so_far_is_poled_once_and_was_not_demagnetised() -> None:
    campaign = draw_campaign(104133, truth="preisach", effects={"initial_state": 2.5})
    view = view_of_recordings(*recorded(campaign))
    shared = with_shared_initial_state(view)
    own = with_individual_initial_states(view, shared)
    assert own.rms < 0.85 * shared.rms
    assert not is_shared_state_as_good(shared, own, view)


def test_a_model_with_an_initial_state_is_no_worse_than_the_simulation_without_it() -> None:
    # A quarter of the usual size; the error of the model was 4.4 times the noise.
    recordings, lab, noise_rms_m = recorded_zoo_stage("preisach", "quarter", 48522301)
    diagnosis = diagnose(recordings, lab=lab)
    assert diagnosis.final.rms_m < diagnosis.baseline.rms_m
    assert diagnosis.final.rms_m < 1.5 * noise_rms_m
