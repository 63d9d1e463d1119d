"""What a diagnosis found goes into the model it was given, and errors are that model's."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import compared
from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effect_size import size_of
from piezoid.diagnosis.effects import delay, rate_dependence
from piezoid.diagnosis.refit import attribute_errors, repair_recordings, repaired_faults
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_structure import SearchResult, UnexplainedResidual
from piezoid.diagnosis.selection import Outcome
from piezoid.identification.extensions import Delay
from piezoid.identification.hysteresis.pieces import scales_of
from piezoid.identification.simulation import simulate_recording
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from tests.identification.joint.stage import NOISE_m, disturbed, known_model, recordings_of

pytestmark = pytest.mark.usefixtures("plays_alone")

DELAY_s = 2e-3


def outcome_of(recordings: Sequence[Recording], *found: SelectedEffect) -> Outcome:
    """Return a search that came to these causes."""
    view = view_on(recordings, axis="x", lab=Lab())
    causes = []
    for one in found:
        there = with_effects(view, [one])
        causes.append(
            Candidate(
                selected=one,
                cv=compared(view.null, there.null),
                placebo=None,
                share=0.01,
                physical=True,
                without=view,
                view=there,
            )
        )
    final = causes[-1].view if causes else view
    return Outcome(
        first=view,
        clean=view,
        final=final,
        faults={},
        causes=tuple(causes),
        confounded={},
        screened={},
    )


def test_a_model_is_returned_with_what_a_search_came_to() -> None:
    recordings = recordings_of(Delay(delay_s=DELAY_s))
    late = SelectedEffect(
        effect=delay.EFFECT, parameters={"delay_s": 1.3 * DELAY_s}, free={"delay_s": 1.5}
    )
    outcome = outcome_of(recordings, late)
    rest = UnexplainedResidual(rms=0.0, share=0.0, p_value=1.0, coordinate="", gain=0.0)
    numbers = attribute_errors(
        SearchResult(raw=outcome.first, outcome=outcome, unexplained=rest),
        recordings,
        model=known_model(),
        lab=Lab(),
        scales=scales_of(recordings, "x"),
    )
    assert numbers.model.lag.kind == "delay"
    assert numbers.model.lag.time_s == pytest.approx(DELAY_s, rel=0.05)
    assert numbers.final_m < 1.5 * NOISE_m
    assert numbers.baseline_m > 10.0 * NOISE_m
    assert numbers.without_m == {"delay": pytest.approx(numbers.baseline_m, rel=0.05)}
    for recording in recordings:
        error_m = simulate_recording(numbers.model, recording) - recording.displacement_m()
        assert np.std(error_m) < 1.5 * NOISE_m


def test_a_model_in_which_nothing_is_wrong_states_its_own_error() -> None:
    model = known_model()
    found = diagnose(recordings_of(), axis="x", model=model)
    assert found.findings == ()
    assert found.final.rms_m == found.model.quality.held_out_rms_m
    assert found.final.rms_m == pytest.approx(found.baseline.rms_m, rel=0.02)
    assert found.final.rms_m == pytest.approx(NOISE_m, rel=0.05)


def test_a_repair_changes_the_recording_where_it_was_and_nothing_else() -> None:
    recordings = recordings_of()
    spiked = (disturbed(recordings[0], slice(700, 701), 4e-7), recordings[1])
    view = view_on(spiked, axis="x", lab=Lab())
    mended = view_on(recordings, axis="x", lab=Lab())
    scales = scales_of(spiked, "x")
    first, second = repair_recordings(spiked, "x", view.tracks, mended.tracks, scales)
    np.testing.assert_allclose(
        first.displacement_m(), recordings[0].displacement_m(), rtol=0, atol=1e-15
    )
    assert second is recordings[1]
    assert np.array_equal(first.voltage_V(), spiked[0].voltage_V())


def test_only_a_fault_that_was_repaired_is_worth_something() -> None:
    outcome = outcome_of(recordings_of())
    known = Fault(tracks=outcome.first.tracks, value=1.0, spread=0.1, p_value=1e-6)
    other = tuple(replace(track, response=0.5 * track.response) for track in known.tracks)
    faults = {"quantisation": known, "outliers": replace(known, tracks=other)}
    assert repaired_faults(replace(outcome, faults=faults)) == ("outliers",)


def test_a_share_of_the_stroke_is_known_the_better_the_surer_its_effect_is() -> None:
    slow = {"time_s": 0.01, "strain": 0.03}
    shared = replace(rate_dependence.EFFECT, size=None)
    (cause,) = outcome_of(recordings_of(), SelectedEffect(effect=shared, parameters=slow)).causes
    reach = []
    for z in (0.5, 4.0, 8.0):
        size = size_of(replace(cause, cv=replace(cause.cv, z=z)))
        low, high = size.ci95
        assert 0.0 <= low < size.value < high
        reach.append((high - low) / size.value)
    assert reach == pytest.approx([2.0, 0.5, 0.25])
