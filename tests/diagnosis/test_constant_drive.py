"""A drive at rest is a recording: drift, hum, other axes and noise are told of it."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effects import EFFECTS
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.frames import from_arrays
from piezoid_datasets.virtual_lab.signals import coloured_noise

RATE_Hz, SAMPLES, NOISE_um = 500.0, 20_000, 0.003
TIME_s = np.arange(SAMPLES) / RATE_Hz
OTHER_V = 5.0 + 4.0 * np.sin(2.0 * np.pi * 0.31 * TIME_s)
DRIFT_um = 0.02 * TIME_s / TIME_s[-1]
CREEP_um = 0.02 * np.log1p(TIME_s)
HUM_um = 0.004 * np.sin(2.0 * np.pi * 49.93 * TIME_s)
COUPLED_um = 0.001 * OTHER_V


def diagnosed(folder: Path, moved_um: Array) -> Diagnosis:
    reading_um = 3.0 + moved_um + NOISE_um * np.random.default_rng(6).standard_normal(SAMPLES)
    rows = zip(TIME_s.tolist(), OTHER_V.tolist(), reading_um.tolist(), strict=True)
    lines = [f"{t:.4f},20.00,{u:.4f},{y:.6f}" for t, u, y in rows]
    heading = "time [s],voltage_x [V],voltage_y [V],displacement_x [um]"
    (folder / "rest.csv").write_text("\n".join([heading, *lines]) + "\n")
    return diagnose([collect([folder / "rest.csv"])[0]], axis="x")


@pytest.mark.parametrize(
    ("moved_um", "names"),
    [
        (np.zeros(SAMPLES), set()),
        (DRIFT_um, {"thermal_drift"}),
        (HUM_um, {"mains_interference"}),
        (COUPLED_um, {"cross_coupling"}),
        (
            DRIFT_um + HUM_um + COUPLED_um,
            {"thermal_drift", "mains_interference", "cross_coupling"},
        ),
    ],
    ids=["nothing", "drift", "hum", "coupling", "all"],
)
def test_what_moves_a_stage_at_rest_is_named_and_sized(
    tmp_path: Path, moved_um: Array, names: set[str]
) -> None:
    found = diagnosed(tmp_path, moved_um)
    assert set(found.names) == names
    assert 1e6 * found.noise_floor_rms_m == pytest.approx(NOISE_um, rel=0.1)
    truth_um = {"thermal_drift": DRIFT_um, "mains_interference": HUM_um}
    for finding in found.findings:
        size_nm = 1e3 * float(np.std(truth_um.get(finding.effect, COUPLED_um)))
        assert finding.size.value == pytest.approx(size_nm, rel=0.1)
    assert {*found.names, *(one.effect for one in found.not_detected)} == {
        effect.name for effect in EFFECTS
    }


@pytest.mark.parametrize("moved_um", [CREEP_um, 0.3 * np.log10(1.0 + TIME_s / 0.3)])
def test_drift_that_slows_down_is_not_told_from_creep(tmp_path: Path, moved_um: Array) -> None:
    (finding,) = diagnosed(tmp_path, moved_um).findings
    assert finding.effect == "thermal_drift"
    assert finding.not_separable_from == ("creep",)


@pytest.mark.parametrize("grid_Hz", [49.9281, 50.2156])
def test_hum_at_any_frequency_of_the_grid_is_one_line(tmp_path: Path, grid_Hz: float) -> None:
    found = diagnosed(tmp_path, 0.05 * np.sin(2.0 * np.pi * grid_Hz * TIME_s))
    assert found.names == ("mains_interference",)
    assert 1e6 * found.noise_floor_rms_m == pytest.approx(NOISE_um, rel=0.1)


def test_noise_at_rest_is_told_with_its_slow_part(tmp_path: Path) -> None:
    slow_um = 2.0 * NOISE_um * coloured_noise(SAMPLES, RATE_Hz, 1e4, 0.4, np.random.default_rng(8))
    found = diagnosed(tmp_path, slow_um)
    assert 1e6 * found.noise_floor_rms_m == pytest.approx(5**0.5 * NOISE_um, rel=0.1)


def test_a_jump_is_no_drift_and_told_with_its_instant(tmp_path: Path) -> None:
    (finding,) = diagnosed(tmp_path, DRIFT_um + 0.03 * (TIME_s > 23.0)).findings[:1]
    assert finding.effect == "something_else"
    assert finding.parameters["instant_s"] == pytest.approx(23.0, abs=0.05)
    assert 1e6 * finding.parameters["jump_m"] == pytest.approx(0.03, rel=0.1)
    assert "one jump by" in finding.explanation


def test_a_line_that_is_not_the_grids_is_told_with_its_frequency(tmp_path: Path) -> None:
    (finding,) = diagnosed(tmp_path, 0.002 * np.sin(2.0 * np.pi * 12.63 * TIME_s)).findings
    assert finding.effect == "something_else"
    assert finding.parameters["frequency_Hz"] == pytest.approx(12.63, abs=0.003)
    assert finding.size.value == pytest.approx(2.0 / np.sqrt(2.0), rel=0.1)
    assert finding.seen is not None


def at_rest(moved_m: Array, *, noise_m: float = 3e-9, seed: int = 6) -> Diagnosis:
    time_s = np.arange(len(moved_m)) / RATE_Hz
    reading_m = moved_m + noise_m * np.random.default_rng(seed).standard_normal(len(moved_m))
    recording = from_arrays(
        time_s=time_s, voltage_V=np.full(len(moved_m), 20.0), displacement_m=reading_m
    )
    return diagnose([recording], axis="x")


def test_a_finding_says_what_the_error_was_and_is_and_how_large_that_is_of_all() -> None:
    hum_m = 4e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s)
    found = at_rest(hum_m)
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


def test_weak_evidence_is_not_called_certain() -> None:
    """Of twelve hums that can just be seen most are named, and few of these are beyond doubt."""
    weak_m = 1e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s[:2000])
    p_values = [
        finding.p_value
        for seed in range(12)
        for finding in at_rest(weak_m, seed=seed).findings
        if finding.effect == "mains_interference"
    ]
    assert len(p_values) > 8
    assert 1e-7 < np.median(p_values) < 1e-3
    assert max(p_values) < 0.01
    sure = at_rest(5e-9 * np.sin(2.0 * np.pi * 50.0 * TIME_s)).findings[0].p_value
    assert sure < 1e-9


def test_a_second_line_is_left_with_its_share_and_its_certainty() -> None:
    """One line of its own is told; the next is what nothing stands for."""
    lines_m = 4e-9 * np.sin(2.0 * np.pi * 12.63 * TIME_s)
    lines_m += 2.5e-9 * np.sin(2.0 * np.pi * 77.7 * TIME_s)
    found = at_rest(lines_m)
    assert found.findings[0].parameters["frequency_Hz"] == pytest.approx(12.63, abs=0.003)
    left = found.unexplained
    assert left.coordinate == "frequency"
    assert left.p_value < 1e-6
    assert left.gain == pytest.approx(3.125 / (3.125 + 9.0), rel=0.1)
    assert left.share == pytest.approx((left.rms_m / found.final.rms_m) ** 2, rel=1e-6)


def test_what_would_have_shown_would_have() -> None:
    silent = at_rest(np.zeros(SAMPLES))
    (limit_m,) = [
        one.detection_limit_m for one in silent.not_detected if one.effect == "mains_interference"
    ]
    assert limit_m is not None
    for times, named in ((1.3, True), (0.6, False)):
        hum_m = times * limit_m * 2**0.5 * np.sin(2.0 * np.pi * 50.0 * TIME_s)
        assert ("mains_interference" in at_rest(hum_m).names) is named
    (unseen,) = [one for one in silent.not_detected if one.effect == "cross_coupling"]
    assert unseen.detection_limit_m is None


def test_a_small_jump_beside_drift_is_no_jump_and_a_larger_one_is() -> None:
    for jump_m, named in ((4e-10, False), (6e-9, True)):
        found = at_rest(2e-8 * TIME_s / TIME_s[-1] + jump_m * (TIME_s > 23.0))
        jumps = [one for one in found.findings if "jump_m" in one.parameters]
        assert bool(jumps) is named
        for one in jumps:
            assert one.seen is not None
            assert one.seen.unit == "s"
            assert one.seen.fitted_m[-1] - one.seen.fitted_m[0] == pytest.approx(jump_m, rel=0.1)
