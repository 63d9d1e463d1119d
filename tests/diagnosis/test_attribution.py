"""What a diagnosis found goes into the model it was given, and errors are that model's."""

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.refit import repair_recordings
from piezoid.identification.hysteresis.pieces import scales_of
from piezoid.records.lab import Lab
from tests.identification.joint.stage import NOISE_m, disturbed, known_model, recordings_of

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")


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
