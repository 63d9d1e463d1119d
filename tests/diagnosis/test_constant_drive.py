"""Recordings at constant drive show drift, hum, coupling of other axes and noise."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effects import EFFECTS
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Channel, Quantity
from piezoid_datasets.virtual_lab.signals import coloured_noise

from .bench import causes, thinned
from .play_stage import drive, noisy_reading_m, recording

RATE_Hz, SAMPLES, NOISE_m = 500.0, 20_000, 3e-9
TIME_s = np.arange(SAMPLES) / RATE_Hz
OTHER_V = 5.0 + 4.0 * np.sin(2.0 * np.pi * 0.31 * TIME_s)
DRIFT_m = 2e-8 * TIME_s / TIME_s[-1]
HUM_m = 4e-9 * np.sin(2.0 * np.pi * 49.93 * TIME_s)
COUPLED_m = 1e-9 * OTHER_V
MAINS = "mains_interference"


def diagnosis_at_rest(motion_m: Array, *, seed: int = 6) -> Diagnosis:
    """Diagnose a motion at constant drive while another axis moves."""
    count = len(motion_m)
    reading_m = 3e-6 + motion_m + NOISE_m * np.random.default_rng(seed).standard_normal(count)
    recording = from_arrays(
        time_s=TIME_s[:count], voltage_V=np.full(count, 20.0), displacement_m=reading_m
    )
    other_drive = Channel(quantity=Quantity.VOLTAGE, axis="y", values=OTHER_V[:count], label="y")
    return diagnose([replace(recording, channels=(*recording.channels, other_drive))], axis="x")


@pytest.mark.parametrize(
    "motions_m",
    [
        {},
        {"thermal_drift": DRIFT_m},
        {"cross_coupling": COUPLED_m},
        {"thermal_drift": DRIFT_m, MAINS: HUM_m, "cross_coupling": COUPLED_m},
    ],
    ids=["nothing", "drift", "coupling", "all"],
)
def test_motion_at_constant_drive_is_named_and_sized(motions_m):
    diagnosis = diagnosis_at_rest(sum(motions_m.values(), np.zeros(SAMPLES)))
    assert set(diagnosis.names) == set(motions_m)
    assert diagnosis.noise_floor_rms_m == pytest.approx(NOISE_m, rel=0.1)
    for finding in diagnosis.findings:
        size_nm = 1e9 * float(np.std(motions_m[finding.effect]))
        assert finding.size.value == pytest.approx(size_nm, rel=0.1)
    absent = {entry.effect for entry in diagnosis.not_detected}
    assert {*diagnosis.names, *absent} == {effect.name for effect in EFFECTS}


def test_decelerating_drift_is_not_separable_from_creep():
    (finding,) = diagnosis_at_rest(2e-8 * np.log1p(TIME_s)).findings
    assert (finding.effect, finding.not_separable_from) == ("thermal_drift", ("creep",))


def test_hum_at_any_mains_frequency_is_one_line():
    diagnosis = diagnosis_at_rest(5e-8 * np.sin(2.0 * np.pi * 50.2156 * TIME_s))
    assert diagnosis.names == (MAINS,)
    assert diagnosis.noise_floor_rms_m == pytest.approx(NOISE_m, rel=0.1)


def test_the_noise_floor_at_rest_includes_coloured_noise():
    slow_m = 2.0 * NOISE_m * coloured_noise(SAMPLES, RATE_Hz, 1e4, 0.4, np.random.default_rng(8))
    assert diagnosis_at_rest(slow_m).noise_floor_rms_m == pytest.approx(5**0.5 * NOISE_m, rel=0.1)


@pytest.mark.parametrize(("jump_m", "is_named"), [(4e-10, False), (6e-9, True), (3e-8, True)])
def test_a_jump_is_something_else_with_its_instant(jump_m, is_named):
    diagnosis = diagnosis_at_rest(DRIFT_m + jump_m * (TIME_s > 23.0))
    jumps = [jump for jump in diagnosis.findings if "jump_m" in jump.parameters]
    assert bool(jumps) is is_named
    for jump in jumps:
        assert jump.effect == "something_else"
        assert jump.parameters["instant_s"] == pytest.approx(23.0, abs=0.05)
        assert jump.parameters["jump_m"] == pytest.approx(jump_m, rel=0.1)
        assert jump.seen.unit == "s"
        assert jump.seen.fitted_m[-1] - jump.seen.fitted_m[0] == pytest.approx(jump_m, rel=0.1)


def test_a_finding_states_its_error_before_and_after_and_its_share_of_the_stroke():
    diagnosis = diagnosis_at_rest(4e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s))
    (finding,) = diagnosis.findings
    assert finding.held_out_rms_before_m == pytest.approx(np.hypot(4e-9 / 2**0.5, 3e-9), rel=0.03)
    assert finding.held_out_rms_after_m == pytest.approx(3e-9, rel=0.03)
    ratio = finding.held_out_rms_after_m / finding.held_out_rms_before_m
    assert finding.held_out_gain == pytest.approx(1.0 - ratio, abs=1e-12)
    assert finding.rms_percent == pytest.approx(1e-7 * finding.size.value / diagnosis.stroke_m)
    low_nm, high_nm = finding.size.ci95
    assert low_nm < 4.0 / 2**0.5 < high_nm
    # The standard error of an rms of a sine from 20,000 readings is sigma / sqrt(n).
    assert (high_nm - low_nm) / 3.92 == pytest.approx(3.0 / SAMPLES**0.5, rel=0.6)
    assert diagnosis.baseline.rms_m == pytest.approx(finding.held_out_rms_before_m, rel=1e-9)
    assert diagnosis.final.rms_m == pytest.approx(finding.held_out_rms_after_m, rel=1e-9)
    percent = 100.0 * diagnosis.final.rms_m / diagnosis.stroke_m
    assert diagnosis.final.rms_percent == pytest.approx(percent)
    assert diagnosis.explained_fraction > 0.99
    assert diagnosis.unexplained.p_value > 1e-3
    assert finding.p_value < 1e-6


def test_weak_evidence_has_a_moderate_p_value():
    """Most of twelve barely detectable hums are named, with moderate p-values."""
    weak_m = 1e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s[:2000])
    p_values = [
        finding.p_value
        for seed in range(12)
        for finding in diagnosis_at_rest(weak_m, seed=seed).findings
        if finding.effect == MAINS
    ]
    assert len(p_values) > 8
    assert 1e-7 < np.median(p_values) < 1e-3
    assert max(p_values) < 0.01


def test_a_line_off_the_mains_is_something_else_and_a_second_line_is_unexplained():
    lines_m = 4e-9 * np.sin(2.0 * np.pi * 12.63 * TIME_s)
    lines_m += 2.5e-9 * np.sin(2.0 * np.pi * 77.7 * TIME_s)
    diagnosis = diagnosis_at_rest(lines_m)
    (finding,) = diagnosis.findings
    assert finding.effect == "something_else"
    assert finding.parameters["frequency_Hz"] == pytest.approx(12.63, abs=0.003)
    assert finding.size.value == pytest.approx(4.0 / np.sqrt(2.0), rel=0.1)
    assert finding.seen is not None
    unexplained = diagnosis.unexplained
    assert unexplained.coordinate == "frequency"
    assert unexplained.p_value < 1e-6
    assert unexplained.gain == pytest.approx(3.125 / (3.125 + 9.0), rel=0.1)
    share = (unexplained.rms_m / diagnosis.final.rms_m) ** 2
    assert unexplained.share == pytest.approx(share, rel=1e-6)


def test_a_hum_is_detected_above_its_detection_limit_only():
    not_detected = diagnosis_at_rest(np.zeros(SAMPLES)).not_detected
    limits_m = {absent.effect: absent.detection_limit_m for absent in not_detected}
    assert limits_m["slew_limit"] is None
    limit_m = limits_m[MAINS]
    for factor, is_named in ((1.3, True), (0.6, False)):
        hum_m = factor * limit_m * 2**0.5 * np.sin(2.0 * np.pi * 50.0 * TIME_s)
        assert (MAINS in diagnosis_at_rest(hum_m).names) is is_named


@pytest.mark.slow
@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_a_piece_at_rest_after_a_gap_is_diagnosed():
    """A clock that lost samples divided a recording within its final rest."""
    field = drive("sweep")[1]
    field = np.append(field, np.full(3000, field[-1]))
    (rested,) = thinned([recording("sweep", noisy_reading_m(field, 1), field)], 6)
    assert causes(diagnose([replace(rested, breaks=(1600,))])) == ()
