"""The signal chain has the lags, converters and noise of the rig, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from piezoid_datasets.virtual_lab.effects.effect import Act, Place, Scene
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, record
from piezoid_datasets.virtual_lab.truths.truth import Ceramic

Array = NDArray[np.float64]
AMPLIFIER_s, SENSOR_s = 1 / (2 * np.pi * 4e3), 1 / (2 * np.pi * 8.5e3)
HOLD_s = 25e-6  # half a period of the rig's 20 kHz clock
LINEAR = Ceramic(
    share=0.0, reversible_curve=lambda field: 0.5 * (field + 1.0), memory=np.zeros_like
)
STAGE = Stage(rig=Rig(stroke_m=30e-6, noise_rms_m=10e-9), ceramic=LINEAR, seed=4)


def ramp(rate_Hz: float, volts_per_s: float, samples: int = 2000) -> Run:
    command_V = volts_per_s * np.arange(samples) / rate_Hz
    return Run(
        name="ramp", sampling_rate_Hz=rate_Hz, command_V=command_V, history_V=np.array([0.0])
    )


def act(stage_place: Place, change: object) -> Act:
    def changed(signal: Array, _scene: Scene, _rng: np.random.Generator) -> Array:
        assert callable(change)
        return np.asarray(change(signal), dtype=np.float64)

    return Act(name="test", place=stage_place, change=changed)


@pytest.mark.parametrize("rate_Hz", [500.0, 20e3])
def test_a_ramp_is_delayed_by_hold_amplifier_and_sensor(rate_Hz):
    rows = record(STAGE, ramp(rate_Hz, 4.0 if rate_Hz < 1e3 else 80.0, 1000))
    speed_m_per_s = 30e-6 / 10.0 * (4.0 if rate_Hz < 1e3 else 80.0)
    late_s = rows.time_s[500:] - rows.noise_free_m[500:] / speed_m_per_s
    dac_s = STAGE.rig.dac_step_V / 2 / (10.0 * speed_m_per_s / 30e-6)  # rounding of the command
    assert abs(np.mean(late_s) - (HOLD_s + AMPLIFIER_s + SENSOR_s)) < 1e-6 + 0.1 * dac_s


def test_the_voltage_column_is_the_command_before_the_amplifier():
    clipped = replace(STAGE, acts=(act(Place.OUTPUT, lambda volts: np.minimum(volts, 20.0)),))
    run = ramp(20e3, 80.0)
    sound, faulty = record(STAGE, run), record(clipped, run)
    assert np.array_equal(sound.voltage_V, faulty.voltage_V)
    assert np.max(np.abs(sound.voltage_V - run.command_V)) <= 0.5 * STAGE.rig.dac_step_V * 1.001
    assert abs(np.max(faulty.noise_free_m) - 30e-6 * 20.0 / 150.0) < 1e-9


def test_readings_lie_on_the_steps_of_the_converter():
    codes = record(STAGE, ramp(20e3, 80.0)).displacement_m / STAGE.rig.adc_step_m
    assert np.max(np.abs(codes - np.round(codes))) < 1e-9


def test_noise_has_the_declared_size_and_is_independent_of_effects():
    rig = replace(STAGE.rig, flicker_share=0.0)
    sound = replace(STAGE, rig=rig)
    amplified = replace(sound, acts=(act(Place.MECHANICS, lambda x: 1.1 * x),))
    noises = [noise_of(record(stage, ramp(20e3, 80.0, 20_000))) for stage in (sound, amplified)]
    assert abs(np.std(noises[0]) / 10e-9 - 1.0) < 0.03  # converter steps add 0.1 %
    assert np.max(np.abs(noises[0] - noises[1])) <= 2.0 * rig.adc_step_m


def noise_of(rows: Rows) -> Array:
    return rows.displacement_m - rows.noise_free_m


def test_another_recording_and_another_seed_have_other_noise():
    run = ramp(500.0, 1.0)
    first = noise_of(record(STAGE, run))
    assert abs(np.corrcoef(first, noise_of(record(STAGE, run, order=1)))[0, 1]) < 0.2
    assert abs(np.corrcoef(first, noise_of(record(replace(STAGE, seed=5), run)))[0, 1]) < 0.2


def test_acts_are_applied_in_the_order_of_the_chain():
    add = act(Place.MECHANICS, lambda x: x + 1e-6)
    double = act(Place.CERAMIC, lambda x: 2.0 * x)
    rows = record(replace(STAGE, acts=(add, double)), ramp(500.0, 0.0, 10))
    assert np.allclose(rows.noise_free_m, 1e-6, atol=1e-12)


def test_rows_missing_in_the_reading_are_missing_in_every_column():
    short = replace(STAGE, acts=(act(Place.RECORD, lambda x: x[:-7]),))
    rows = record(short, replace(ramp(500.0, 1.0, 50), others_V={"y": np.zeros(50)}))
    columns = (rows.time_s, rows.voltage_V, rows.displacement_m, rows.others_V["y"])
    assert {len(column) for column in columns} == {43}
