"""Comparison of a model with new recordings: unchanged, another sensitivity, or another stage."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.compare import compare
from piezoid.diagnosis.signals import with_displacement
from piezoid.formatting import with_unit
from piezoid.identification.extensions import FirstOrderLag, GainChange, ThermalDrift
from piezoid.identification.quality import Verdict
from tests.identification.extended_stage import NOISE_m, known_model, recordings_of


def test_an_unchanged_stage_confirms_the_model():
    comparison = compare(known_model(), recordings_of())
    assert comparison.holds
    assert not comparison.sensitivity_changed
    assert comparison.unchanged_error_m < 1.3 * NOISE_m
    value, low, high = comparison.gain_ratio
    assert low <= 1.0 <= high
    assert value == pytest.approx(1.0, abs=1e-3)


def test_a_confirmation_states_the_error_of_the_fit_and_the_limit():
    model = known_model()
    comparison = compare(model, recordings_of())
    fitted_m = model.quality.held_out_rms_m
    assert comparison.limit_m == pytest.approx(3.0 * fitted_m, rel=0.05)
    text = comparison.statement.text
    assert f"at the fit {with_unit(fitted_m, 'm')}" in text
    assert f"may grow to {with_unit(comparison.limit_m, 'm')}" in text
    assert "plays with dead zones" not in text
    shaped = replace(comparison, shaped_error_m=0.1 * fitted_m)
    assert "Error of plays with dead zones now" in shaped.statement.text
    just_above = replace(comparison, unchanged_error_m=1.01 * comparison.limit_m)
    assert comparison.holds
    assert not just_above.holds


@pytest.mark.parametrize(("ratio", "phrase"), [(1.03, "more than"), (0.88, "less than")])
def test_a_changed_sensitivity_is_measured_and_explains_the_error(ratio, phrase):
    change = GainChange(recording="slow.csv", instant_s=0.0, ratio=ratio, later=("fast.csv",))
    comparison = compare(known_model(), recordings_of(change))
    assert comparison.gain_ratio[0] == pytest.approx(ratio, abs=2e-3)
    assert phrase in comparison.statement.text
    assert comparison.unchanged_error_m > 5 * NOISE_m
    assert comparison.rescaled_error_m < 1.3 * NOISE_m


def test_a_changed_lag_is_not_attributed_to_the_sensitivity():
    comparison = compare(known_model(), recordings_of(FirstOrderLag(lag_s=0.01)))
    assert not comparison.only_sensitivity_changed
    assert comparison.refitted_error_m < 0.9 * comparison.rescaled_error_m


@pytest.mark.parametrize("is_random", [False, True], ids=["another stage", "random walk"])
def test_a_model_of_another_stage_does_not_hold(is_random):
    """With a random walk, the estimated sensitivity reaches its bound."""
    unrelated = []
    for recording in recordings_of():
        reading_m = 2e-6 * np.sin(np.arange(recording.samples) / 97.0)
        if is_random:
            reading_m = np.cumsum(np.random.default_rng(7).normal(size=recording.samples)) / 1e7
        unrelated.append(with_displacement(recording, reading_m))
    comparison = compare(known_model(), unrelated)
    assert not comparison.holds
    text = comparison.statement.text
    assert "% of the motion" in text
    assert not is_random or not ("90.00" in text or "e+" in text)


def test_a_changed_sensitivity_is_measured_despite_outliers():
    change = GainChange(recording="slow.csv", instant_s=0.0, ratio=1.12, later=("fast.csv",))
    disturbed = []
    for recording in recordings_of(change):
        reading_m = np.array(recording.displacement_m())
        reading_m[77::83] += 0.4e-6
        disturbed.append(with_displacement(recording, reading_m))
    comparison = compare(known_model(), disturbed)
    assert comparison.gain_ratio[0] == pytest.approx(1.12, abs=2e-3)
    assert comparison.only_sensitivity_changed
    assert "12." in comparison.statement.text
    assert not comparison.holds


def test_a_noisier_sensor_is_not_another_stage():
    rng = np.random.default_rng(5)
    noisy = []
    for recording in recordings_of():
        noise_m = 5 * NOISE_m * rng.normal(size=recording.samples)
        noisy.append(with_displacement(recording, recording.displacement_m() + noise_m))
    comparison = compare(known_model(), noisy)
    assert comparison.holds
    assert not comparison.sensitivity_changed
    assert "sensor noise rose" in comparison.statement.text


def test_an_inapplicable_model_does_not_hold():
    inapplicable = replace(known_model(), verdict=Verdict(applies=False, reason="loops turn back"))
    comparison = compare(inapplicable, recordings_of())
    assert not comparison.holds
    assert "loops turn back" in comparison.statement.text


def test_drift_of_earlier_recordings_does_not_affect_a_comparison():
    drifted = replace(known_model(), extensions=(ThermalDrift.of([]),))
    expected = compare(known_model(), recordings_of())
    assert compare(drifted, recordings_of()).to_json() == expected.to_json()
