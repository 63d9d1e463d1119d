"""Drift, hum and resolution of the closed loop, in metres of gap."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_noise import (
    CurrentChain,
    LoopNoise,
    budget_resolution,
    gap_motion,
    measure_loop_noise,
    power_density,
)
from piezoid.operators.tunnelling import decay_of_barrier
from piezoid_datasets.virtual_lab.junction import Junction
from tests.identification.tunnelling.loops import (
    DRIFTING_JUNCTION,
    HUMLESS_JUNCTION,
    HUMMING_JUNCTION,
    STRONGLY_ATTENUATED_DRIVE,
    VIBRATING_JUNCTION,
    identified,
    record_of,
    rig_of,
)

CHAIN = CurrentChain(bandwidth_Hz=7000.0, feedback_ohm=1e9, adc_step_A=10.0 / 2**15 * 1e-9)


RIG = rig_of(Junction(), bandwidth_Hz=7e3, feedback_ohm=1e9)


def measured(junction: Junction, periods: int = 21) -> LoopNoise:
    record = record_of(junction, periods)
    noise = measure_loop_noise(record, identified(record, junction).plant, RIG)
    assert noise is not None
    return noise


def test_the_drift_rate_lies_in_its_interval():
    noise = measured(DRIFTING_JUNCTION)
    low, high = noise.drift_interval_m_per_s
    assert low < 60e-12 < high
    assert noise.drift_m_per_s == pytest.approx(60e-12, abs=10e-12)


def test_the_hum_is_found_at_its_frequency_and_size():
    noise = measured(HUMMING_JUNCTION)
    assert noise.mains[0].frequency_Hz == pytest.approx(60.0, abs=0.3)
    assert noise.mains[0].amplitude_m == pytest.approx(6e-12, rel=0.15, abs=0.0)


def test_a_record_without_hum_has_no_mains_line():
    noise = measured(HUMLESS_JUNCTION)
    assert noise.mains == ()


def test_a_vibration_is_a_peak_of_the_spectrum():
    record = record_of(VIBRATING_JUNCTION, 21)
    fit = identified(record, VIBRATING_JUNCTION)
    decay_per_m = decay_of_barrier(fit.barrier_eV)
    motion_m = gap_motion(record, fit.plant, decay_per_m)
    frequency_Hz, density = power_density(motion_m, record.sampling_rate_Hz)
    band = (frequency_Hz > 70.0) & (frequency_Hz < 1000.0)
    assert frequency_Hz[band][np.argmax(density[band])] == pytest.approx(140.0, abs=10.0)


def test_the_published_budget_at_one_nanoampere_and_ten_kilohertz():
    """Shot noise 1.79 pA, Johnson noise of 1 GOhm 4.0e-15 A/rtHz; steps of the drive dominate."""
    chain = CurrentChain(bandwidth_Hz=10e3, feedback_ohm=1e9, adc_step_A=0.305e-12)
    assert chain.shot_A(1e-9) == pytest.approx(1.79e-12, rel=5e-3, abs=0.0)
    assert chain.johnson_A / 100.0 == pytest.approx(4.0e-15, rel=0.02, abs=0.0)
    sources = budget_resolution(
        set_point_A=1e-9,
        decay_per_m=decay_of_barrier(1.0),
        drive_step_m=5.49e-12,
        sampling_rate_Hz=20e3,
        chain=chain,
        gap_rms_m=0.0,
    )
    in_pm = {source.name: source.rms_m * 1e12 for source in sources}
    assert in_pm["shot"] == pytest.approx(0.17, abs=0.01)
    assert in_pm["drive_step"] == pytest.approx(1.59, abs=0.01)
    assert max(in_pm, key=lambda name: in_pm[name]) == "drive_step"


@pytest.mark.parametrize("motion_m", [1e-12, 1e-13])
def test_the_gap_noise_is_the_motion_beyond_the_noise_of_the_electronics(motion_m):
    *reading, _, gap = budget_resolution(
        set_point_A=1e-9,
        decay_per_m=decay_of_barrier(1.0),
        drive_step_m=5e-12,
        sampling_rate_Hz=20e3,
        chain=CHAIN,
        gap_rms_m=motion_m,
    )
    electronics_m = np.sqrt(sum(source.rms_m**2 for source in reading))
    total_m = np.hypot(electronics_m, gap.rms_m)
    assert total_m == pytest.approx(max(motion_m, electronics_m), rel=1e-9, abs=0.0)


def test_the_limiting_electronics_change_with_an_attenuator():
    direct, attenuated = (
        measured(junction, periods=12) for junction in (Junction(), STRONGLY_ATTENUATED_DRIVE)
    )
    assert direct.limiting_electronics == "drive_step"
    assert attenuated.limiting_electronics == "shot"
    assert direct.limiting_source == attenuated.limiting_source == "gap"


def test_the_bandwidth_of_the_budget_is_declared_or_that_of_the_pole():
    record = record_of(Junction(), 6)
    for declared_Hz, pole_Hz, expected_Hz in ((7e3, 3e3, 7e3), (None, 3e3, 3e3), (None, 3e4, 1e4)):
        plant = JunctionPlant(
            gain_nepers_per_V=400.0,
            sensor_pole_Hz=pole_Hz,
            delay_s=3e-5,
            amplifier_pole_Hz=4e3,
            sampling_rate_Hz=record.sampling_rate_Hz,
        )
        noise = measure_loop_noise(record, plant, replace(RIG, bandwidth_Hz=declared_Hz))
        assert noise.bandwidth_Hz == pytest.approx(expected_Hz)


def test_a_record_too_short_for_mains_lines_has_no_budget():
    record = record_of(Junction(), 9)
    plant = identified(record, Junction()).plant
    samples = int(0.49 * record.sampling_rate_Hz)
    short = replace(
        record,
        **{
            name: getattr(record, name)[:samples] for name in ("reference", "drive_V", "current_A")
        },
    )
    assert measure_loop_noise(short, plant, RIG) is None


def test_the_power_density_integrates_to_the_variance(rng):
    signal = rng.standard_normal(40000)
    frequency_Hz, density = power_density(signal, 1000.0)
    assert np.sum(density) * frequency_Hz[1] == pytest.approx(np.var(signal), rel=0.03)
