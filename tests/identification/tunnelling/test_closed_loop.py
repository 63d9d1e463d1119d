"""Plant and barrier are identified in closed loop, where the plain transfer function is wrong."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import tf2ss

from piezoid.errors import ExcitationError
from piezoid.identification.quality import Confidence
from piezoid.identification.tunnelling.closed_loop import (
    identify_closed_loop,
    mean_of,
    spread_family,
)
from piezoid.identification.tunnelling.instrument_fit import (
    LoopSpectra,
    fit_with_instrument,
    spectra_of_dither,
)
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.operators.linear import ContinuousSystem, sample
from piezoid_datasets.virtual_lab.junction import Junction
from tests.identification.tunnelling.loops import (
    ATTENUATED_DRIVE,
    BARRIERS,
    FAST_SENSOR,
    NOISELESS_JUNCTION,
    PERIOD_SAMPLES,
    SLOW_SENSOR,
    identified,
    loop_records,
    record_of,
    rig_of,
)


def test_barriers_within_five_percent_and_intervals_with_their_coverage():
    """Eight records of four seconds; the benchmark does fifty of eight."""
    junctions = [junction for n, junction in enumerate(BARRIERS) if n % 5 < 2]
    barriers_eV = np.array([junction.barrier_eV for junction in junctions])
    fits = [identified(record_of(junction), junction) for junction in junctions]
    error = np.array([fit.barrier_eV for fit in fits]) / barriers_eV - 1.0
    is_inside = [
        fit.barrier_interval_eV[0] < truth < fit.barrier_interval_eV[1]
        for fit, truth in zip(fits, barriers_eV, strict=True)
    ]
    assert np.median(np.abs(error)) < 0.025
    assert np.max(np.abs(error)) < 0.08  # four standard deviations of the longest interval
    assert sum(is_inside) >= 6  # 7.6 expected, 2.5 standard deviations are 1.5
    naive = np.array([abs(fit.naive_error) for fit in fits])
    assert np.median(naive) > 0.15
    assert np.median(naive) > 5.0 * np.median(np.abs(error))


def test_delay_and_sensor_pole_are_identified_with_their_intervals():
    fit = identified(record_of(SLOW_SENSOR), SLOW_SENSOR)
    assert fit.delay_interval_s[0] < 40e-6 < fit.delay_interval_s[1]
    assert fit.sensor_pole_interval_Hz[0] < 5000.0 < fit.sensor_pole_interval_Hz[1]
    assert fit.plant.delay_s == pytest.approx(40e-6, abs=5e-6)


def test_a_pole_beyond_the_resolved_band_is_bounded_from_below_only():
    """It resembles a delay; the estimate and its family stay plausible."""
    junction = replace(SLOW_SENSOR, sensor_pole_Hz=30e3)
    fit = identified(loop_records([junction], periods=11, seed=3)[0], junction)
    assert fit.sensor_pole_interval_Hz[0] > 4e3
    assert fit.sensor_pole_interval_Hz[1] == np.inf
    assert fit.confidence is not Confidence.HIGH
    assert any("sensor pole" in reason for reason in fit.reasons)
    family = spread_family([fit])
    assert min(member.sensor_pole_Hz for member in family) > 3e3
    assert max(member.delay_s for member in family) < 80e-6


def test_an_undetermined_pole_stays_within_the_search_range():
    fit = identified(record_of(Junction(), 11), Junction())
    covariance = fit.covariance.copy()
    covariance[1, :] *= 1e4
    covariance[:, 1] *= 1e4
    members = spread_family([replace(fit, covariance=covariance)])
    poles_Hz = [member.sensor_pole_Hz for member in members]
    assert 99.0 < min(poles_Hz) <= max(poles_Hz) < 10.1e3
    gains = np.log([member.gain_nepers_per_V for member in members])
    assert np.ptp(gains) == pytest.approx(2.0 * 1.96 * np.sqrt(covariance[0, 0]), rel=1e-3)


def test_the_gain_of_a_noiseless_junction_is_accurate():
    fit = identified(record_of(NOISELESS_JUNCTION, 21), NOISELESS_JUNCTION)
    truth = NOISELESS_JUNCTION.decay_per_m * NOISELESS_JUNCTION.drive_gain_m_per_V
    assert fit.plant.gain_nepers_per_V == pytest.approx(truth, rel=5e-3)
    assert fit.confidence is Confidence.HIGH


def test_the_naive_error_does_not_decrease_with_a_longer_record():
    short, long = (
        identified(record_of(ATTENUATED_DRIVE, periods), ATTENUATED_DRIVE) for periods in (11, 41)
    )
    assert abs(short.naive_error) > 0.15
    assert abs(long.naive_error) > 0.15
    assert "minus the controller's inverse" in long.naive_reason
    assert np.ptp(long.gain_interval) < np.ptp(short.gain_interval)


@pytest.mark.parametrize(
    ("dither", "rel"),
    [
        ({"seed": 9, "periodic": False}, 0.12),
        ({"seed": 41, "in_drive": True, "rms": 3e-12 / 18e-9}, 0.05),  # three picometres of tip
    ],
)
def test_an_aperiodic_dither_or_one_added_to_the_drive_identifies_the_barrier(dither, rel):
    (record,) = loop_records([ATTENUATED_DRIVE], periods=21, **dither)
    fit = identified(record, ATTENUATED_DRIVE)
    assert fit.barrier_interval_eV[0] < ATTENUATED_DRIVE.barrier_eV < fit.barrier_interval_eV[1]
    assert fit.barrier_eV == pytest.approx(ATTENUATED_DRIVE.barrier_eV, rel=rel)


def test_a_weak_dither_gives_a_wide_interval_and_states_it():
    junction = Junction(drive_range_V=1.0, flicker_m=5e-12)
    fit = identified(loop_records([junction], periods=12, seed=11, rms=0.02)[0], junction)
    assert fit.confidence is not Confidence.HIGH
    assert any("95 % interval" in reason for reason in fit.reasons)


@pytest.mark.parametrize(("polarity", "unit"), [(-1.0, 1.0), (1.0, 1e-3)])
def test_the_sign_of_the_current_and_the_unit_of_the_dither_do_not_matter(polarity, unit):
    record = record_of(Junction(), 12)
    changed = replace(
        record,
        current_A=polarity * record.current_A,
        set_point_A=polarity * record.set_point_A,
        reference=unit * record.reference,
    )
    reference, gain = (
        identified(r, Junction()).plant.gain_nepers_per_V for r in (record, changed)
    )
    assert reference == pytest.approx(gain, rel=1e-6)


@pytest.mark.parametrize("is_periodic", [True, False])
def test_all_lines_except_those_of_the_mains_are_used_at_any_rate(is_periodic):
    record = loop_records([Junction()], periods=10, seed=13, periodic=False)[0]
    if is_periodic:
        record = replace(record, period_samples=PERIOD_SAMPLES)
    frequency_Hz = spectra_of_dither(record, highest_Hz=8000.0).frequency_Hz
    spacing_Hz = record.sampling_rate_Hz / (PERIOD_SAMPLES if is_periodic else 512)
    for harmonic_Hz in (50.0, 60.0, 100.0, 120.0, 150.0):
        assert np.abs(frequency_Hz - harmonic_Hz).min() > 0.5 * spacing_Hz - 1e-9
    slow = replace(record, sampling_rate_Hz=2.0)
    slow_Hz = spectra_of_dither(slow, highest_Hz=0.9).frequency_Hz
    assert slow_Hz[0] == pytest.approx(spacing_Hz * 2.0 / record.sampling_rate_Hz)


@pytest.mark.parametrize(
    ("periods", "change", "message"),
    [
        (10, lambda r: {"reference": 0.0 * r.reference}, "does not move"),
        (5, lambda _: {}, "4 whole periods"),
        (5, lambda r: {"set_point_A": -r.set_point_A}, "10000 of 10000 currents"),
        (10, lambda r: {"drive_V": -r.drive_V}, "falls as the drive rises"),
    ],
    ids=["no dither", "too short", "sign of the set point", "sign of the drive"],
)
def test_an_unidentifiable_record_is_refused(periods, change, message):
    record = record_of(Junction(), periods)
    with pytest.raises(ExcitationError, match=message):
        identified(replace(record, **change(record)), Junction())


def test_an_uncertain_extension_widens_the_barrier_only():
    fit = identified(record_of(Junction(), 12), Junction(), extension_uncertainty=0.05)
    assert np.ptp(np.log(fit.gain_interval)) < 0.1
    assert np.ptp(fit.barrier_interval_eV) > 0.38 * fit.barrier_eV  # 2 * 2 * 1.96 * 5 %


@pytest.mark.parametrize(
    ("junction", "tolerance"), [(SLOW_SENSOR, 1.08), (SLOW_SENSOR, 0.92), (FAST_SENSOR, 1.0)]
)
def test_the_interval_of_the_delay_allows_for_inaccurate_declared_poles(junction, tolerance):
    """Both poles are wrong by 8 % in the same direction: two microseconds of delay or more."""
    fit = identified(
        record_of(junction, 21),
        junction,
        amplifier_pole_Hz=tolerance * junction.amplifier_pole_Hz,
        bandwidth_Hz=tolerance * junction.sensor_pole_Hz,
    )
    assert fit.delay_interval_s[0] < 40e-6 < fit.delay_interval_s[1]
    assert np.ptp(fit.delay_interval_s) < 20e-6
    assert fit.plant.delay_s == pytest.approx(40e-6, abs=4e-6 if tolerance == 1.0 else 8e-6)


def test_common_errors_of_records_do_not_average_out():
    """Two records that share half of their variance determine the mean less accurately."""
    fit = identified(record_of(Junction(), 11), Junction())
    correlated = replace(fit, common=0.5 * fit.covariance)
    variances = [
        mean_of([member] * 2)[1] for member in (replace(fit, common=0.0 * fit.common), correlated)
    ]
    np.testing.assert_allclose((variances[1] / variances[0]) ** 2, 1.5)


def test_an_offset_of_the_current_is_removed_or_covered_by_the_interval():
    """Fifty picoamperes of a nanoampere: 5 % of the gain and 10 % of the barrier."""
    junction, record = ATTENUATED_DRIVE, record_of(ATTENUATED_DRIVE)
    offset_record = replace(record, current_A=record.current_A + 50e-12)
    fits = [
        identify_closed_loop(offset_record, rig_of(junction), offset_A=offset)
        for offset in (
            (50e-12, 1e-13),
            (0.0, 30e-12),
            (0.0, 1e-13),
        )
    ]
    truth = identified(record, junction).plant.gain_nepers_per_V
    assert fits[0].plant.gain_nepers_per_V == pytest.approx(truth, rel=1e-6)
    assert fits[1].gain_interval[0] < truth < fits[1].gain_interval[1]
    assert fits[2].plant.gain_nepers_per_V < 0.98 * truth


def test_blocks_of_an_aperiodic_dither_do_not_bias_the_gain():
    """A slow junction of one second: blocks of 512 samples alone would lose 0.23 % of the gain."""
    noiseless = replace(
        NOISELESS_JUNCTION,
        wander_m_per_root_s=0.0,
        sensor_pole_Hz=2000.0,
        amplifier_pole_Hz=2000.0,
        latency_s=50e-6,
    )
    truth = noiseless.decay_per_m * noiseless.drive_gain_m_per_V
    records = loop_records([noiseless] * 6, periods=10, seed=21, periodic=False)
    gains = [identified(record, noiseless).plant.gain_nepers_per_V for record in records]
    assert np.mean(gains) == pytest.approx(truth, rel=1.5e-3)


def spectra_of(plant: JunctionPlant, mode: DriveMode, *, seed: int, noise: float) -> LoopSpectra:
    """Return spectra of 32 blocks of 200 lines; the dither is the drive, the output is noisy."""
    frequency_Hz = np.linspace(40.0, 8000.0, 200)
    parts = np.random.default_rng(seed).standard_normal((4, 32, 200))
    drive = parts[0] + 1j * parts[1]
    output = plant.frequency_response(frequency_Hz, mode) * drive
    output = output + noise * (parts[2] + 1j * parts[3])
    return LoopSpectra(frequency_Hz=frequency_Hz, reference=drive, drive=drive, output=output)


def test_a_mode_of_the_drive_biases_neither_gain_nor_delay():
    """A fifth of the extension has a mode at 5 kHz: the response is the plant times the mode."""
    plant = JunctionPlant(
        gain_nepers_per_V=0.3,
        sensor_pole_Hz=6000.0,
        delay_s=70e-6,
        amplifier_pole_Hz=3000.0,
        sampling_rate_Hz=20e3,
    )
    mode = DriveMode(frequency_Hz=5000.0, quality=12.0, share=0.2)
    fit = fit_with_instrument(
        spectra_of(plant, mode, seed=5, noise=0.01),
        amplifier_pole_Hz=3000.0,
        sensor_pole_Hz=6300.0,
        sampling_rate_Hz=20e3,
    )
    assert fit.mode.frequency_Hz == pytest.approx(5000.0, rel=0.01)
    assert fit.mode.share == pytest.approx(0.2, rel=0.1)
    assert fit.plant.gain_nepers_per_V == pytest.approx(0.3, rel=0.01)
    assert fit.plant.delay_s == pytest.approx(70e-6, abs=2e-6)


def test_a_mode_is_sampled_with_the_plant_also_above_the_nyquist_frequency():
    """Reference: matrix exponential of amplifier, sensor and mode in series."""
    plant = JunctionPlant(
        gain_nepers_per_V=2.0,
        sensor_pole_Hz=6000.0,
        delay_s=72e-6,
        amplifier_pole_Hz=3000.0,
        sampling_rate_Hz=20e3,
    )
    amplifier, sensor, mode = 2.0 * np.pi * np.array([3000.0, 6000.0, 13000.0])
    top = 2.0 * amplifier * sensor * np.array([0.3, 0.3 * mode / 6.0, mode**2])
    bottom = np.polymul(np.polymul([1.0, amplifier], [1.0, sensor]), [1.0, mode / 6.0, mode**2])
    A, B, C, D = tf2ss(top, bottom)
    system = ContinuousSystem(A=A, B=B, C=C, D=D, delay_s=72e-6)
    frequency_Hz = np.linspace(10.0, 9900.0, 23)
    response = plant.frequency_response(
        frequency_Hz, DriveMode(frequency_Hz=13000.0, quality=6.0, share=0.7)
    )
    assert response == pytest.approx(
        sample(system, 20e3).response(frequency_Hz)[:, 0, 0], rel=1e-10
    )


def test_the_interval_of_the_delay_allows_for_modes_beyond_the_lines():
    """A mode at 30 kHz advances the drive like a faster pole; no line shows it as a mode."""
    mode = DriveMode(frequency_Hz=30e3, quality=10.0, share=1.0)
    covered = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        plant = JunctionPlant(
            gain_nepers_per_V=0.3,
            sensor_pole_Hz=3000.0 * math.exp(rng.uniform(-0.05, 0.05)),
            delay_s=rng.uniform(60e-6, 110e-6),
            amplifier_pole_Hz=5000.0,
            sampling_rate_Hz=20e3,
        )
        fit = fit_with_instrument(
            spectra_of(plant, mode, seed=seed, noise=0.09),
            amplifier_pole_Hz=5000.0,
            sensor_pole_Hz=3000.0,
            sampling_rate_Hz=20e3,
        )
        half_s = 1.96 * math.sqrt(fit.covariance[2, 2]) / 20e3
        covered += abs(fit.plant.delay_s - plant.delay_s) <= half_s
    assert covered >= 9  # seven of twelve without this allowance
