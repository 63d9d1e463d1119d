"""From what a search found to the model that ships, and what each finding is worth."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import piezoid.diagnosis.effects as effects
from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.effect import EffectEstimate
from piezoid.diagnosis.refit import ModelErrors, refit_model, repair_recordings
from piezoid.identification.extensions import CreepLadder, Delay, GainChange, SlewLimit
from piezoid.identification.hysteresis.pieces import Scales, scales_of
from piezoid.identification.model import Lag
from piezoid.identification.simulation import simulate_recording
from piezoid.records.lab import Acquisition, Lab
from piezoid.records.recording import Recording
from tests.identification.joint.stage import NOISE_m, disturbed, known_model, recordings_of

SCALES = Scales(voltage_V=5.0, voltage_offset_V=5.0, displacement_m=1.2e-5)
CREEP = CreepLadder(time_s=tuple(np.geomspace(0.02, 200.0, 12).tolist()), share=(0.008,) * 12)
TRUE = (SlewLimit(limit_V_per_s=80.0), Delay(delay_s=5e-4), CREEP)
FOUND = (
    EffectEstimate(effect="slew_limit", parameters={"limit_per_s": 15.5}, coefficient=np.zeros(0)),
    EffectEstimate(effect="delay", parameters={"delay_s": 3e-4}, coefficient=np.array([1.2])),
    EffectEstimate(effect="creep", coefficient=np.array([0.02])),
)


def _refitted(recordings: Sequence[Recording], found: Sequence[EffectEstimate], **asked: Any):
    known = {"model": known_model(), "lab": Lab(), "scales": SCALES, "raw": recordings}
    return refit_model(recordings, found, **{**known, **asked})


@cache
def _errors_with_all_effects() -> ModelErrors:
    return _refitted(recordings_of(*TRUE), FOUND)


def test_every_effect_but_faults_of_the_data_has_its_place_in_the_model():
    homeless = {
        effect.name
        for effect in effects.EFFECTS
        if effect.extend is None and effect.structural is None and effect.fault is None
    }
    assert homeless == {"asymmetry", "loop_shape"}, "which belong to the class of hysteresis"


def test_each_finding_is_worth_what_the_error_rises_by_without_it():
    numbers = _errors_with_all_effects()
    assert numbers.final_m < 1.5 * NOISE_m
    for error_m in numbers.without_m.values():
        assert 1.3 * numbers.final_m < error_m < numbers.baseline_m
    slew = next(e for e in numbers.model.extensions if isinstance(e, SlewLimit))
    assert slew.limit_V_per_s == pytest.approx(80.0, rel=0.02)


def test_the_one_lag_ships_where_the_runtime_looks_for_it():
    model = _errors_with_all_effects().model
    assert model.lag.kind == "delay"
    assert model.lag.time_s == pytest.approx(5e-4, rel=0.05)
    assert not any(isinstance(e, Delay) for e in model.extensions)
    for recording in recordings_of(*TRUE):
        error_m = simulate_recording(model, recording) - recording.displacement_m()
        assert np.std(error_m) < 1.5 * NOISE_m


@pytest.mark.parametrize("is_later", [False, True])
def test_the_gain_of_a_recording_shows_whether_it_was_made_after_a_change(is_later):
    """Files may be given in the order of their names."""
    first, second = (recording.name for recording in recordings_of())
    later = (second,) if is_later else ()
    change = GainChange(recording=first, instant_s=5.0, ratio=0.97, later=later)
    place = 5.0 / recordings_of()[0].duration_s
    found = EffectEstimate(
        effect="gain_change",
        parameters={"track": 0.0, "place": place},
        coefficient=np.array([-0.03, 0.0]),
    )
    (fitted,) = (
        e
        for e in _refitted(recordings_of(change), (found,)).model.extensions
        if isinstance(e, GainChange)
    )
    assert (fitted.recording, fitted.later) == (first, later)
    assert fitted.ratio == pytest.approx(0.97, abs=2e-3)


def test_a_repaired_fault_is_worth_what_it_did_to_the_raw_recordings():
    recordings = recordings_of()
    broken = (disturbed(recordings[0], slice(3000, 3200), 2e-7), recordings[1])
    numbers = _refitted(recordings, (), raw=broken, faults=("outliers",))
    assert numbers.without_m["outliers"] > 1.5 * numbers.final_m
    assert numbers.baseline_m > 1.5 * numbers.final_m


@pytest.mark.parametrize("delay_s", [1e-3, 0.0], ids=["held by the clock", "not held"])
def test_the_clock_that_the_laboratory_declares_is_no_finding(delay_s):
    """Nor does it make a stage late whose drive moves between samples, as of a generator."""
    declared = Lab(acquisition=Acquisition(sampling_rate_Hz=500.0))
    if delay_s:
        numbers = _refitted(recordings_of(Delay(delay_s=delay_s)), (), lab=declared)
    else:
        early = replace(known_model(), lag=Lag(kind="delay", time_s=0.0))
        numbers = _refitted(recordings_of(), (), lab=declared, model=early)
    assert numbers.baseline_m < 1.3 * NOISE_m


def test_a_finding_alone_and_the_baseline_have_the_same_error_without_it():
    """An initial state that is a finding is none of the baseline."""
    found = (EffectEstimate(effect="initial_state"),)
    numbers = _refitted(recordings_of(), found)
    assert numbers.without_m["initial_state"] == pytest.approx(numbers.baseline_m, rel=1e-9)


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_model_in_which_nothing_is_wrong_states_its_own_error():
    model = known_model()
    found = diagnose(recordings_of(), axis="x", model=model)
    assert found.findings == ()
    assert found.final.rms_m == found.model.quality.held_out_rms_m
    assert found.final.rms_m == pytest.approx(found.baseline.rms_m, rel=0.02)
    assert found.final.rms_m == pytest.approx(NOISE_m, rel=0.05)


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_repair_changes_the_recording_where_it_was_and_nothing_else():
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
