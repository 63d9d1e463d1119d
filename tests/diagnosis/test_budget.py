"""The error budget adds up and names every error above the noise."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid import diagnose
from piezoid.diagnosis.budget import RemainingErrors, with_budget
from piezoid.diagnosis.diagnosis import BudgetPart, Diagnosis
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses, write_diagnosis
from piezoid.identification.simulation import simulate_recording
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Recording
from tests.diagnosis.bench import finding_of
from tests.diagnosis.ceramic import NOISE_um, bouc_wen_um
from tests.plays_alone import fit_few_rows, fit_one_order, fit_plays_alone
from tests.reports.known_diagnosis import diagnosed, finding


@cache
def bouc_wen_diagnosis() -> tuple[Recording, Diagnosis]:
    """Return decaying loops of a Bouc-Wen ceramic and their diagnosis."""
    time_s = np.arange(3000) / 500.0
    height_V = np.where(time_s < 3.0, 100.0, 100.0 - 25.0 * (time_s - 3.0))
    drive_V = height_V * 0.5 * (1.0 - np.cos(2.0 * np.pi * time_s))
    reading_um = bouc_wen_um(drive_V) + np.random.default_rng(7).normal(0.0, NOISE_um, len(time_s))
    loops = from_arrays(time_s=time_s, voltage_V=drive_V, displacement_m=1e-6 * reading_um)
    with pytest.MonkeyPatch.context() as patch:
        fit_one_order(patch)
        fit_few_rows(patch)
        return loops, diagnose([loops])


def power(diagnosis: Diagnosis) -> float:
    return sum(part.rms_m**2 for part in diagnosis.budget)


def part_of(diagnosis: Diagnosis, name: str) -> BudgetPart:
    return next(part for part in diagnosis.budget if part.part == name)


@pytest.mark.slow
def test_loops_of_another_class_are_named_loop_shape_only():
    _, bouc_wen = bouc_wen_diagnosis()
    assert bouc_wen.names == ("loop_shape",)
    assert part_of(bouc_wen, "loop_shape").rms_m > 3.0 * NOISE_um * 1e-6


@pytest.mark.slow
def test_the_final_error_is_that_of_the_model_and_the_budget_adds_up():
    loops, bouc_wen = bouc_wen_diagnosis()
    assert bouc_wen.final.rms_m == bouc_wen.model.quality.held_out_rms_m
    assert part_of(bouc_wen, "loop_shape").is_explained
    assert power(bouc_wen) == pytest.approx(bouc_wen.baseline.rms_m**2, rel=1e-9)
    assert read_diagnoses(write_diagnosis(bouc_wen))[0] == bouc_wen
    error_m = simulate_recording(bouc_wen.model, loops) - loops.displacement_m()
    assert np.std(error_m) == pytest.approx(bouc_wen.model.quality.rms_m, rel=0.1)


def budget_of(diagnosis: Diagnosis, explained_m: float, wide_m: float) -> dict[str, float]:
    errors = RemainingErrors(explained_m=explained_m, wide_m=wide_m, scatter=0.01)
    completed = with_budget(diagnosis, errors)
    assert power(completed) == pytest.approx(diagnosis.baseline.rms_m**2)
    return {part.part: part.rms_m for part in completed.budget}


def test_each_error_is_split_by_the_next_smaller_one():
    parts = budget_of(diagnosed(finding("creep", 0.4)), explained_m=2e-8, wide_m=1e-8)
    assert parts["creep"] == pytest.approx(4e-8)
    assert parts["extrapolation"] == pytest.approx(np.sqrt(5.0) * 1e-8)
    assert parts["loop_shape"] == pytest.approx(np.sqrt(3.0) * 1e-8)
    assert parts["unexplained"] == pytest.approx(np.sqrt(0.75) * 1e-8)
    assert parts["noise"] == pytest.approx(5e-9)


@pytest.mark.parametrize(("gain_m", "left_m"), [(2e-8, 2e-8), (9e-8, np.sqrt(9.75) * 1e-8)])
def test_a_mode_of_other_recordings_has_at_most_the_part_that_other_findings_leave(gain_m, left_m):
    """Of 16 (1e-16 m^2), creep removes 6.25; a refit without the mode may cost more than 9.75."""
    creep = replace(
        finding("creep", 0.4),
        held_out_rms_before_m=5e-8,
        held_out_rms_after_m=np.sqrt(18.75) * 1e-8,
    )
    errors = RemainingErrors(explained_m=3e-8, wide_m=3e-8, scatter=0.01)
    diagnosis = diagnosed(creep, finding("resonance", 0.4))
    completed = with_budget(diagnosis, errors, gains={"resonance": gain_m**2})
    power_m2 = diagnosis.baseline.rms_m**2 - diagnosis.final.rms_m**2
    expected_m2 = left_m**2 * power_m2 / (6.25e-16 + left_m**2)
    assert part_of(completed, "resonance").rms_m ** 2 == pytest.approx(expected_m2)
    assert power(completed) == pytest.approx(diagnosis.baseline.rms_m**2)


def test_a_dominant_residual_is_something_else_with_its_coordinate():
    errors = RemainingErrors(explained_m=3e-8, wide_m=3e-8, scatter=0.01)
    diagnosis = with_budget(diagnosed(finding("creep", 0.4)), errors)
    assert finding_of(diagnosis, "something_else").coordinate == "drive"
    assert diagnosis.largest_remaining.part in ("something_else", "unexplained")


def test_unmodelled_structure_is_part_of_the_final_error():
    errors = RemainingErrors(explained_m=2.5e-8, wide_m=1e-8, scatter=0.01, structure_m=2e-8)
    findings = finding("creep", 0.4), finding("something_else", 0.4)
    diagnosis = with_budget(diagnosed(*findings), errors)
    assert not part_of(diagnosis, "something_else").is_explained
    assert part_of(diagnosis, "something_else").rms_m == pytest.approx(2e-8)
    assert part_of(diagnosis, "creep").rms_m == pytest.approx(4e-8)
    assert part_of(diagnosis, "loop_shape").rms_m == pytest.approx(np.sqrt(1.25) * 1e-8)
    assert power(diagnosis) == pytest.approx(diagnosis.baseline.rms_m**2)


@pytest.mark.slow
def test_the_error_of_coarse_readings_is_quantisation_and_not_something_else():
    loops, _ = bouc_wen_diagnosis()
    step_m = 60e-6 * NOISE_um
    coarse = from_arrays(
        time_s=np.arange(loops.samples) / loops.sampling_rate_Hz,
        voltage_V=loops.voltage_V(),
        displacement_m=step_m * np.round(loops.displacement_m() / step_m),
    )
    with pytest.MonkeyPatch.context() as patch:
        fit_one_order(patch)
        fit_plays_alone(patch)
        diagnosis = diagnose([coarse])
    assert "quantisation" in diagnosis.names
    assert "something_else" not in diagnosis.names
    part = part_of(diagnosis, "quantisation")
    assert not part.is_explained
    rms_m = np.hypot(part.rms_m, diagnosis.noise_floor_rms_m)
    assert rms_m == pytest.approx(step_m / np.sqrt(12.0), rel=0.2)
    assert power(diagnosis) == pytest.approx(diagnosis.baseline.rms_m**2, rel=1e-9)
