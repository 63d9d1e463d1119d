"""Since a model was fitted: nothing, another sensitivity, or more than that."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.compare import compare
from piezoid.diagnosis.signals import with_displacement
from piezoid.identification.extensions import FirstOrderLag, GainChange, ThermalDrift
from piezoid.identification.quality import Verdict
from tests.identification.joint.stage import NOISE_m, known_model, recordings_of


def test_a_model_that_still_holds_is_said_to_hold():
    found = compare(known_model(), recordings_of())
    assert "still holds" in found.statement.text
    assert found.unchanged_error_m < 1.3 * NOISE_m
    value, low, high = found.gain_ratio
    assert low <= 1.0 <= high
    assert value == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("ratio", "said"), [(1.03, "more than"), (0.88, "less than")])
def test_another_sensitivity_is_measured_and_explains_the_error(ratio, said):
    change = GainChange(recording="slow.csv", instant_s=0.0, ratio=ratio, later=("fast.csv",))
    found = compare(known_model(), recordings_of(change))
    assert found.gain_ratio[0] == pytest.approx(ratio, abs=2e-3)
    assert said in found.statement.text
    assert found.unchanged_error_m > 5 * NOISE_m
    assert found.rescaled_error_m < 1.3 * NOISE_m


def test_more_than_a_sensitivity_is_not_given_to_it():
    found = compare(known_model(), recordings_of(FirstOrderLag(lag_s=0.01)))
    assert "more than the sensitivity changed" in found.statement.text
    assert found.refitted_error_m < 0.9 * found.rescaled_error_m


@pytest.mark.parametrize("is_random", [False, True], ids=["another stage", "wandering"])
def test_a_model_of_another_stage_does_not_hold_and_the_figure_says_so(is_random):
    """Where a sensor wanders, the search for a sensitivity runs into its end."""
    strange = []
    for recording in recordings_of():
        reading_m = 2e-6 * np.sin(np.arange(recording.samples) / 97.0)
        if is_random:
            reading_m = np.cumsum(np.random.default_rng(7).normal(size=recording.samples)) / 1e7
        strange.append(with_displacement(recording, reading_m))
    found = compare(known_model(), strange)
    assert not found.holds
    text = found.statement.text
    assert "does not hold" in text
    assert "% of the motion" in text
    assert not is_random or not ("90.00" in text or "e+" in text)


def test_a_sensitivity_is_told_beside_sparks_as_in_a_clean_file():
    more = GainChange(recording="slow.csv", instant_s=0.0, ratio=1.12, later=("fast.csv",))
    sparked = []
    for recording in recordings_of(more):
        reading_m = np.array(recording.displacement_m())
        reading_m[77::83] += 0.4e-6
        sparked.append(with_displacement(recording, reading_m))
    found = compare(known_model(), sparked)
    assert found.gain_ratio[0] == pytest.approx(1.12, abs=2e-3)
    assert "only the sensitivity changed" in found.statement.text
    assert "12." in found.statement.text
    assert not found.holds


def test_a_noisier_sensor_is_no_other_stage():
    rng = np.random.default_rng(5)
    noisy = [
        with_displacement(
            recording,
            recording.displacement_m() + 5 * NOISE_m * rng.normal(size=recording.samples),
        )
        for recording in recordings_of()
    ]
    found = compare(known_model(), noisy)
    assert "still holds" in found.statement.text
    assert "sensor noise rose" in found.statement.text


def test_a_model_that_never_applied_holds_nowhere():
    never = replace(known_model(), verdict=Verdict(applies=False, reason="loops turn back"))
    found = compare(never, recordings_of())
    assert not found.holds
    assert "still holds" not in found.statement.text
    assert "loops turn back" in found.statement.text


def test_what_belonged_to_the_recordings_of_then_is_left_behind():
    drift = ThermalDrift.of([])
    old = replace(known_model(), extensions=(drift,))
    assert (
        compare(old, recordings_of()).to_json()
        == compare(known_model(), recordings_of()).to_json()
    )
