"""From what a search found to the model that ships, and what each finding is worth."""

import numpy as np
import pytest

import piezoid.diagnosis.effects as effects
from piezoid.diagnosis.effect import EffectEstimate
from piezoid.diagnosis.refit import refitted
from piezoid.identification.extensions import CreepLadder, Delay, SlewLimit
from piezoid.identification.simulation import simulate_recording
from piezoid.records.lab import Acquisition, Lab
from tests.identification.joint.stage import NOISE_m, disturbed, known_model, recordings_of

SCALES = {"voltage_V": 5.0, "voltage_offset_V": 5.0, "stroke_m": 1.2e-5}
CREEP = CreepLadder(time_s=tuple(np.geomspace(0.02, 200.0, 12).tolist()), share=(0.008,) * 12)
TRUE = (SlewLimit(limit_V_per_s=80.0), Delay(delay_s=5e-4), CREEP)
FOUND = (
    EffectEstimate(effect="slew_limit", parameters={"limit_per_s": 15.5}, coefficient=np.zeros(0)),
    EffectEstimate(effect="delay", parameters={"delay_s": 3e-4}, coefficient=np.array([1.2])),
    EffectEstimate(effect="creep", coefficient=np.array([0.02])),
)


def test_every_effect_but_faults_of_the_data_has_its_place_in_the_model() -> None:
    homeless = {
        effect.name
        for effect in effects.EFFECTS
        if effect.extend is None and effect.structural is None and effect.fault is None
    }
    assert homeless == {"asymmetry", "loop_shape"}, "which belong to the class of hysteresis"


def test_each_finding_is_worth_what_the_error_rises_by_without_it() -> None:
    recordings = recordings_of(*TRUE)
    numbers = refitted(recordings, FOUND, model=known_model(), lab=Lab(), scales=SCALES)
    assert numbers.final.held_out_rms_m < 1.5 * NOISE_m
    for error in numbers.without.values():
        assert 1.3 * numbers.final.held_out_rms_m < error.held_out_rms_m
        assert error.held_out_rms_m < numbers.baseline.held_out_rms_m
    (slew,), (delay,) = numbers.extensions["slew_limit"], numbers.extensions["delay"]
    assert slew.free().value[0] == pytest.approx(80.0, rel=0.02)
    assert delay.free().value[0] == pytest.approx(5e-4, rel=0.05)
    assert numbers.spread["delay"][0][0] < 5e-5


def test_the_one_lag_ships_where_the_runtime_looks_for_it() -> None:
    recordings = recordings_of(*TRUE)
    numbers = refitted(recordings, FOUND, model=known_model(), lab=Lab(), scales=SCALES)
    assert numbers.model.lag.kind == "delay"
    assert numbers.model.lag.time_s == numbers.extensions["delay"][0].free().value[0]
    assert not any(isinstance(e, Delay) for e in numbers.model.extensions)
    for recording in recordings:
        np.testing.assert_allclose(
            simulate_recording(numbers.model, recording),
            simulate_recording(numbers.final.model, recording),
            atol=1e-15,
        )


def test_a_repaired_fault_is_worth_what_it_did_to_the_raw_recordings() -> None:
    recordings = recordings_of()
    broken = (disturbed(recordings[0], slice(3000, 3200), 2e-7), recordings[1])
    numbers = refitted(
        recordings,
        (),
        model=known_model(),
        lab=Lab(),
        scales=SCALES,
        raw=broken,
        faults=("outliers",),
    )
    assert numbers.without["outliers"].held_out_rms_m > 1.5 * numbers.final.held_out_rms_m
    assert numbers.baseline.held_out_rms_m > 1.5 * numbers.final.held_out_rms_m


def test_the_clock_that_the_laboratory_declares_is_no_finding() -> None:
    recordings = recordings_of(Delay(delay_s=1e-3))
    declared = Lab(acquisition=Acquisition(sampling_rate_Hz=500.0))
    numbers = refitted(recordings, (), model=known_model(), lab=declared, scales=SCALES)
    assert numbers.baseline.held_out_rms_m < 1.3 * NOISE_m
