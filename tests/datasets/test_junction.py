"""The virtual junction obeys its physics; its records depend only on their seeds."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid_datasets.virtual_lab.junction import Junction, multisine, simulate_junctions

STILL = Junction(
    drift_m_per_s=0.0,
    wander_m_per_root_s=0.0,
    vibration_m=0.0,
    flicker_m=0.0,
    mains_gap_m=0.0,
    mains_current_A=0.0,
)


def test_an_undisturbed_junction_stays_at_its_set_point():
    """The step of the drive is 0.11 nepers at 4 eV."""
    (record,) = simulate_junctions([STILL], reference_nepers=np.zeros(4000), seeds=[1])
    nepers = np.log(record.current_A / record.set_point_A)
    assert np.max(np.abs(nepers)) < 0.15
    assert np.mean(nepers) == pytest.approx(0.0, abs=0.01)


def test_a_larger_drive_extends_the_tip_and_raises_the_current():
    fine = replace(STILL, drive_range_V=0.1)
    step = np.concatenate([np.zeros(2000), np.full(2000, 0.3)])
    (record,) = simulate_junctions([fine], reference_nepers=step, seeds=[2], settle_samples=0)
    rise_V = record.drive_V[-500:].mean() - record.drive_V[1500:2000].mean()
    assert rise_V * 18e-9 * fine.decay_per_m == pytest.approx(0.3, rel=1e-3)
    assert np.log(record.current_A[-500:].mean() / 1e-9) == pytest.approx(0.3, abs=1e-3)


def test_the_loop_follows_the_drift():
    drifting = replace(STILL, drift_m_per_s=100e-12)
    (record,) = simulate_junctions([drifting], reference_nepers=np.zeros(20000), seeds=[3])
    slope = np.polyfit(np.arange(20000) / 20000.0, record.drive_V * 18e-9, 1)[0]
    # The step of the drive is 5 % of the drift in a second.
    assert slope == pytest.approx(100e-12, rel=0.05, abs=0.0)


def test_the_current_of_a_still_tip_shows_shot_noise():
    """The loop is open, and the noise bandwidth of a pole is pi/2 f."""
    open_loop = replace(STILL, integral_gain_V=0.0, sensor_pole_Hz=2000.0)
    (record,) = simulate_junctions([open_loop], reference_nepers=np.zeros(40000), seeds=[4])
    expected_A = np.sqrt(2 * 1.602e-19 * 1e-9 * 2000.0 * np.pi / 2)
    assert np.std(record.current_A) == pytest.approx(expected_A, rel=0.03, abs=0.0)


def test_both_converters_are_quantised():
    (record,) = simulate_junctions([Junction()], reference_nepers=np.zeros(500), seeds=[5])
    for values, step in ((record.drive_V, 10.0 / 2**15), (record.current_A, 1e-8 / 2**15)):
        assert np.round(values / step) * step == pytest.approx(values, abs=1e-6 * step)


def test_a_record_depends_only_on_its_seed():
    reference = multisine(500, 4, lines=[3, 7], rms=0.1, rng=np.random.default_rng(6))
    single = simulate_junctions([Junction()], reference_nepers=reference, seeds=[7])[0]
    several = simulate_junctions([Junction()] * 3, reference_nepers=reference, seeds=[8, 7, 9])
    assert np.array_equal(single.current_A, several[1].current_A)
    assert not np.array_equal(single.current_A, several[0].current_A)


def test_the_dither_has_its_lines_and_size():
    dither = multisine(500, 4, lines=[3, 7], rms=0.1, rng=np.random.default_rng(6))
    spectrum = np.abs(np.fft.rfft(dither[:500]))
    assert np.std(dither) == pytest.approx(0.1, rel=1e-9)
    assert set(np.flatnonzero(spectrum > 1e-6 * spectrum.max())) == {3, 7}


def test_a_latency_of_more_than_a_tick_is_refused():
    with pytest.raises(ValueError, match="latency_s"):
        Junction(latency_s=60e-6)
