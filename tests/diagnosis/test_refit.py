"""Refit of the model with the effects of a search, and the error reduction of each finding."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

import piezoid.diagnosis.effects as effects
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effect import EffectEstimate
from piezoid.diagnosis.refit import ModelErrors, refit_model, repair_recordings
from piezoid.identification.extensions import CreepLadder, Delay, GainChange, SlewLimit
from piezoid.identification.hysteresis.pieces import Scales, scales_of
from piezoid.identification.simulation import simulate_recording
from piezoid.records.recording import Recording
from tests.diagnosis.bench import view_of_recordings
from tests.identification.extended_stage import NOISE_m, disturbed, known_model, recordings_of

SCALES = Scales(voltage_V=5.0, voltage_offset_V=5.0, displacement_m=1.2e-5)
CREEP = CreepLadder(time_s=tuple(np.geomspace(0.02, 200.0, 12).tolist()), share=(0.008,) * 12)
SIMULATED = (SlewLimit(limit_V_per_s=80.0), Delay(delay_s=5e-4), CREEP)
ESTIMATED = (
    EffectEstimate(effect="slew_limit", parameters={"limit_per_s": 15.5}, coefficient=np.zeros(0)),
    EffectEstimate(effect="delay", parameters={"delay_s": 3e-4}, coefficient=np.array([1.2])),
    EffectEstimate(effect="creep", coefficient=np.array([0.02])),
)


def _refitted(
    recordings: Sequence[Recording], estimates: Sequence[EffectEstimate], **options: Any
):
    defaults = {"model": known_model(), "scales": SCALES, "raw": recordings}
    return refit_model(recordings, estimates, **{**defaults, **options})


@cache
def _errors_with_all_effects() -> ModelErrors:
    return _refitted(recordings_of(*SIMULATED), ESTIMATED)


def test_every_effect_but_faults_of_the_data_has_a_part_in_the_model():
    without_model_part = {
        effect.name
        for effect in effects.EFFECTS
        if effect.extend is None and effect.structural is None and effect.fault is None
    }
    assert without_model_part == {"asymmetry", "loop_shape"}, "parts of the hysteresis class"


def test_removing_an_effect_raises_the_error_of_the_model():
    errors = _errors_with_all_effects()
    assert errors.final_m < 1.5 * NOISE_m
    for error_m in errors.without_m.values():
        assert 1.3 * errors.final_m < error_m < errors.baseline_m
    slew_limit = next(e for e in errors.model.extensions if isinstance(e, SlewLimit))
    assert slew_limit.limit_V_per_s == pytest.approx(80.0, rel=0.02)


def test_a_single_delay_becomes_the_lag_of_the_model():
    model = _errors_with_all_effects().model
    assert model.lag.kind == "delay"
    assert model.lag.time_s == pytest.approx(5e-4, rel=0.05)
    assert not any(isinstance(e, Delay) for e in model.extensions)
    for recording in recordings_of(*SIMULATED):
        error_m = simulate_recording(model, recording) - recording.displacement_m()
        assert np.std(error_m) < 1.5 * NOISE_m


@pytest.mark.parametrize("is_later", [False, True])
def test_the_gain_of_a_recording_shows_whether_it_followed_a_change(is_later):
    """Files may be in alphabetical order."""
    first_name, second_name = (recording.name for recording in recordings_of())
    later = (second_name,) if is_later else ()
    change = GainChange(recording=first_name, instant_s=5.0, ratio=0.97, later=later)
    relative_instant = 5.0 / recordings_of()[0].duration_s
    estimate = EffectEstimate(
        effect="gain_change",
        parameters={"track": 0.0, "place": relative_instant},
        coefficient=np.array([-0.03, 0.0]),
    )
    (fitted,) = (
        e
        for e in _refitted(recordings_of(change), (estimate,)).model.extensions
        if isinstance(e, GainChange)
    )
    assert (fitted.recording, fitted.later) == (first_name, later)
    assert fitted.ratio == pytest.approx(0.97, abs=2e-3)


def test_a_repaired_fault_is_credited_with_its_error_in_the_raw_recordings():
    recordings = recordings_of()
    disturbed_recordings = (disturbed(recordings[0], slice(3000, 3200), 2e-7), recordings[1])
    errors = _refitted(recordings, (), raw=disturbed_recordings, faults=("outliers",))
    assert errors.without_m["outliers"] > 1.5 * errors.final_m
    assert errors.baseline_m > 1.5 * errors.final_m


def test_the_hold_of_the_converter_is_part_of_the_baseline():
    recordings = recordings_of(Delay(delay_s=1e-3))
    assert _refitted(recordings, ()).baseline_m > 2.0 * NOISE_m
    assert _refitted(recordings, (), hold_s=1e-3).baseline_m < 1.3 * NOISE_m


def test_without_the_only_finding_the_error_is_that_of_the_baseline():
    """The baseline excludes an initial state that is a finding."""
    estimates = (EffectEstimate(effect="initial_state"),)
    errors = _refitted(recordings_of(), estimates)
    assert errors.without_m["initial_state"] == pytest.approx(errors.baseline_m, rel=1e-9)


@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_a_model_without_findings_states_its_error():
    model = known_model()
    diagnosis = diagnose(recordings_of(), axis="x", model=model)
    assert diagnosis.findings == ()
    assert diagnosis.final.rms_m == diagnosis.model.quality.held_out_rms_m
    assert diagnosis.final.rms_m == pytest.approx(diagnosis.baseline.rms_m, rel=0.02)
    assert diagnosis.final.rms_m == pytest.approx(NOISE_m, rel=0.05)


@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_a_repair_changes_the_faulty_samples_only():
    recordings = recordings_of()
    spiked = (disturbed(recordings[0], slice(700, 701), 4e-7), recordings[1])
    view = view_of_recordings(spiked)
    repaired = view_of_recordings(recordings)
    scales = scales_of(spiked, "x")
    first, second = repair_recordings(spiked, "x", view.tracks, repaired.tracks, scales)
    np.testing.assert_allclose(
        first.displacement_m(), recordings[0].displacement_m(), rtol=0, atol=1e-15
    )
    assert second is recordings[1]
    assert np.array_equal(first.voltage_V(), spiked[0].voltage_V())
