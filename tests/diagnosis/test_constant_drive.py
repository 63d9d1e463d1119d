"""A drive at rest is a recording: drift, hum, other axes and noise are told of it."""

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

RATE_Hz, SAMPLES, NOISE_m = 500.0, 20_000, 3e-9
TIME_s = np.arange(SAMPLES) / RATE_Hz
OTHER_V = 5.0 + 4.0 * np.sin(2.0 * np.pi * 0.31 * TIME_s)
DRIFT_m = 2e-8 * TIME_s / TIME_s[-1]
HUM_m = 4e-9 * np.sin(2.0 * np.pi * 49.93 * TIME_s)
COUPLED_m = 1e-9 * OTHER_V
MAINS = "mains_interference"


def at_rest(moved_m: Array, *, seed: int = 6) -> Diagnosis:
    """Diagnose a motion at a drive that rests, beside another axis that moves."""
    count = len(moved_m)
    reading_m = 3e-6 + moved_m + NOISE_m * np.random.default_rng(seed).standard_normal(count)
    one = from_arrays(
        time_s=TIME_s[:count], voltage_V=np.full(count, 20.0), displacement_m=reading_m
    )
    other = Channel(quantity=Quantity.VOLTAGE, axis="y", values=OTHER_V[:count], label="y")
    return diagnose([replace(one, channels=(*one.channels, other))], axis="x")


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"thermal_drift": DRIFT_m},
        {"cross_coupling": COUPLED_m},
        {"thermal_drift": DRIFT_m, MAINS: HUM_m, "cross_coupling": COUPLED_m},
    ],
    ids=["nothing", "drift", "coupling", "all"],
)
def test_what_moves_a_stage_at_rest_is_named_and_sized(parts):
    found = at_rest(sum(parts.values(), np.zeros(SAMPLES)))
    assert set(found.names) == set(parts)
    assert found.noise_floor_rms_m == pytest.approx(NOISE_m, rel=0.1)
    for finding in found.findings:
        size_nm = 1e9 * float(np.std(parts[finding.effect]))
        assert finding.size.value == pytest.approx(size_nm, rel=0.1)
    absent = {one.effect for one in found.not_detected}
    assert {*found.names, *absent} == {effect.name for effect in EFFECTS}


def test_drift_that_slows_down_is_not_told_from_creep():
    (finding,) = at_rest(2e-8 * np.log1p(TIME_s)).findings
    assert (finding.effect, finding.not_separable_from) == ("thermal_drift", ("creep",))


def test_hum_at_any_frequency_of_the_grid_is_one_line():
    found = at_rest(5e-8 * np.sin(2.0 * np.pi * 50.2156 * TIME_s))
    assert found.names == (MAINS,)
    assert found.noise_floor_rms_m == pytest.approx(NOISE_m, rel=0.1)


def test_noise_at_rest_is_told_with_its_slow_part():
    slow_m = 2.0 * NOISE_m * coloured_noise(SAMPLES, RATE_Hz, 1e4, 0.4, np.random.default_rng(8))
    assert at_rest(slow_m).noise_floor_rms_m == pytest.approx(5**0.5 * NOISE_m, rel=0.1)


@pytest.mark.parametrize(("jump_m", "is_named"), [(4e-10, False), (6e-9, True), (3e-8, True)])
def test_a_jump_is_no_drift_and_told_with_its_instant(jump_m, is_named):
    found = at_rest(DRIFT_m + jump_m * (TIME_s > 23.0))
    jumps = [one for one in found.findings if "jump_m" in one.parameters]
    assert bool(jumps) is is_named
    for one in jumps:
        assert one.effect == "something_else"
        assert one.parameters["instant_s"] == pytest.approx(23.0, abs=0.05)
        assert one.parameters["jump_m"] == pytest.approx(jump_m, rel=0.1)
        assert one.seen is not None
        assert one.seen.unit == "s"
        assert one.seen.fitted_m[-1] - one.seen.fitted_m[0] == pytest.approx(jump_m, rel=0.1)


def test_a_finding_says_what_the_error_was_and_is_and_how_large_that_is_of_all():
    found = at_rest(4e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s))
    (finding,) = found.findings
    assert finding.held_out_rms_before_m == pytest.approx(np.hypot(4e-9 / 2**0.5, 3e-9), rel=0.03)
    assert finding.held_out_rms_after_m == pytest.approx(3e-9, rel=0.03)
    left = finding.held_out_rms_after_m / finding.held_out_rms_before_m
    assert finding.held_out_gain == pytest.approx(1.0 - left, abs=1e-12)
    assert finding.rms_percent == pytest.approx(1e-7 * finding.size.value / found.stroke_m)
    low_nm, high_nm = finding.size.ci95
    assert low_nm < 4.0 / 2**0.5 < high_nm
    # 20,000 readings tell an rms of a sine to sigma / sqrt(n)
    assert (high_nm - low_nm) / 3.92 == pytest.approx(3.0 / SAMPLES**0.5, rel=0.6)
    assert found.baseline.rms_m == pytest.approx(finding.held_out_rms_before_m, rel=1e-9)
    assert found.final.rms_m == pytest.approx(finding.held_out_rms_after_m, rel=1e-9)
    assert found.final.rms_percent == pytest.approx(100.0 * found.final.rms_m / found.stroke_m)
    assert found.explained_fraction > 0.99
    assert found.unexplained.p_value > 1e-3
    assert finding.p_value < 1e-6


def test_weak_evidence_is_not_called_certain():
    """Of twelve hums that can just be seen most are named, and few of these are beyond doubt."""
    weak_m = 1e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s[:2000])
    p_values = [
        finding.p_value
        for seed in range(12)
        for finding in at_rest(weak_m, seed=seed).findings
        if finding.effect == MAINS
    ]
    assert len(p_values) > 8
    assert 1e-7 < np.median(p_values) < 1e-3
    assert max(p_values) < 0.01


def test_a_line_that_is_not_the_grids_is_told_and_a_second_one_is_left_with_its_share():
    lines_m = 4e-9 * np.sin(2.0 * np.pi * 12.63 * TIME_s)
    lines_m += 2.5e-9 * np.sin(2.0 * np.pi * 77.7 * TIME_s)
    found = at_rest(lines_m)
    (finding,) = found.findings
    assert finding.effect == "something_else"
    assert finding.parameters["frequency_Hz"] == pytest.approx(12.63, abs=0.003)
    assert finding.size.value == pytest.approx(4.0 / np.sqrt(2.0), rel=0.1)
    assert finding.seen is not None
    left = found.unexplained
    assert left.coordinate == "frequency"
    assert left.p_value < 1e-6
    assert left.gain == pytest.approx(3.125 / (3.125 + 9.0), rel=0.1)
    assert left.share == pytest.approx((left.rms_m / found.final.rms_m) ** 2, rel=1e-6)


def test_what_would_have_shown_would_have():
    silent = {one.effect: one.detection_limit_m for one in at_rest(np.zeros(SAMPLES)).not_detected}
    assert silent["slew_limit"] is None
    limit_m = silent[MAINS]
    assert limit_m is not None
    for times, named in ((1.3, True), (0.6, False)):
        hum_m = times * limit_m * 2**0.5 * np.sin(2.0 * np.pi * 50.0 * TIME_s)
        assert (MAINS in at_rest(hum_m).names) is named
