"""A step of the zero is reported with size and time, and separates pieces."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.fit import fit
from piezoid.numerics.arrays import Array
from piezoid.records.baseline_steps import baseline_steps
from piezoid.records.recording import Recording
from piezoid.statement import Statement
from tests.laws import LAWS, recorded, triangles
from tests.records.tables import statements_of

FIELD = triangles(8, 300, 0.04)
NOISE_um = 0.008


def recording_with(folder: Path, law: str, added_um: Array, field: Array = FIELD) -> Recording:
    noise_um = NOISE_um * np.random.default_rng(3).standard_normal(len(field))
    return recorded(folder, field, 10.0 * LAWS[law](field) + added_um + noise_um)


def jumps_of(recording: Recording) -> list[Statement]:
    return statements_of(recording, "zero_jump")


def zero_steps(*steps: tuple[int, float], ramp: int = 1) -> Array:
    row = np.arange(len(FIELD))
    return sum(
        (size * np.clip((row - sample + 1) / ramp, 0.0, 1.0) for sample, size in steps),
        np.zeros(len(FIELD)),
    )


@pytest.mark.parametrize("law", LAWS)
def test_a_step_of_the_zero_is_detected_with_sample_and_size(tmp_path, law):
    clean = recording_with(tmp_path, law, zero_steps())
    assert not jumps_of(clean)
    slipped = recording_with(tmp_path, law, zero_steps((1000, 0.9)))
    (statement,) = jumps_of(slipped)
    assert " at 1.998 s" in statement.text
    assert slipped.breaks == (1000,)
    segments_m = [slipped.displacement_m()[piece] for piece in slipped.pieces]
    shift_m = np.concatenate(segments_m) - clean.displacement_m()
    assert np.ptp(shift_m[:1000]) < 1e-12
    assert statement.value == pytest.approx(0.9e-6, rel=0.06)


def test_fringe_errors_are_recognised_by_their_equal_size(tmp_path):
    fringes = zero_steps((420, 0.3164), (1160, 0.3164), (1790, -0.6328))
    (statement,) = jumps_of(recording_with(tmp_path, "preisach", fringes))
    assert "helium-neon laser loses multiples of 316 nm" in statement.text
    (statement,) = jumps_of(
        recording_with(tmp_path, "preisach", zero_steps((420, 0.24), (1160, 0.86), (1790, 0.55)))
    )
    assert "multiples" not in statement.text


def test_a_step_is_detected_with_a_slow_sensor_and_at_constant_drive(tmp_path):
    recording = recording_with(tmp_path, "dahl", zero_steps((1000, 1.5), ramp=6))
    assert len(jumps_of(recording)) == 1
    assert any(990 < edge <= 1000 for edge in recording.breaks)
    assert any(1000 < edge < 1015 for edge in recording.breaks)
    recording = recording_with(tmp_path, "plays", zero_steps((700, 0.25)), np.zeros(len(FIELD)))
    (statement,) = jumps_of(recording)
    assert statement.value == pytest.approx(0.25e-6, rel=0.15)


@pytest.mark.parametrize("law", ["duhem", "plays", "dahl"])
def test_a_displacement_that_returns_with_the_drive_is_no_step(tmp_path, law):
    few = FIELD[:1500]
    one_spot = 0.9 * (few > 0.2)
    for spots in (one_spot, one_spot + 0.6 * (few > 0.6), one_spot + 0.6 * (few > 0.35)):
        assert not jumps_of(recording_with(tmp_path, law, spots, few))


def test_switching_readings_and_steps_of_the_drive_are_no_steps_of_the_zero(tmp_path):
    switching = zero_steps(*((k, 0.9 * (-1) ** n) for n, k in enumerate(range(150, 2300, 300))))
    assert not jumps_of(recording_with(tmp_path, "duhem", switching))
    levels = np.round(10.0 * FIELD) / 10.0
    assert not jumps_of(recording_with(tmp_path, "plays", np.zeros(len(FIELD)), levels))
    drive = np.round(50.0 * np.abs(np.arange(2000) / 125.0 % 2.0 - 1.0), 4)
    assert baseline_steps(np.round(0.2 * drive, 5), drive) == ()


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_fit_after_a_step_has_its_error_and_states_the_limit(tmp_path):
    clean = recording_with(tmp_path, "preisach", zero_steps())
    slipped = recording_with(tmp_path, "preisach", zero_steps((1000, 0.9)))
    clean_axis, slipped_axis = (fit([recording]).axes["x"] for recording in (clean, slipped))
    assert slipped_axis.quality.held_out_rms_m < 1.5 * clean_axis.quality.held_out_rms_m
    (limit,) = (
        recording for recording in slipped_axis.quality.limits if recording.lack == "zero_jump"
    )
    assert limit.reason.startswith("sweep.csv: The zero of the displacement steps once")
    worst_first = [recording.most for recording in slipped_axis.quality.limits]
    assert all(a <= b for a, b in pairwise(worst_first))


@pytest.mark.parametrize("law", LAWS)
def test_equal_cycles_reveal_a_step_below_ten_times_the_noise(law):
    field = triangles(8, 300)
    clean_um = 10.0 * LAWS[law](field)
    noise_um = 0.06 * np.random.default_rng(5).standard_normal(len(FIELD))
    (step,) = baseline_steps(clean_um + zero_steps((1100, 0.5)) + noise_um, field)
    assert abs(step.last - 1100) <= 3
    assert step.size == pytest.approx(0.5, rel=0.15)
    assert baseline_steps(clean_um + noise_um, field) == ()
    other_gain = np.where(np.arange(len(FIELD)) < 1100, 1.0, 1.03)
    assert baseline_steps(other_gain * clean_um + noise_um, field) == ()
