"""Dead, clipped, wrapped and coarse channels, and the noise of a smooth one."""

import re
from pathlib import Path

import numpy as np
import pytest

import piezoid
from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.inspection import ColumnSummary, inspect_files
from piezoid.records.recording import Recording
from tests.records.tables import HEADINGS, quantities_of, table

TIME_s = np.arange(20000) / 1000.0
SINE = np.sin(2 * np.pi * np.arange(20000) / 4000)
NOISE = np.random.default_rng(3).standard_normal(20000)
# To nine tenths of half the sampling rate, through a resonance.
PER_SAMPLE = np.linspace(0.0, 0.45, 20000)
CHIRP = 0.003 + 1.0 / (1.0 + ((PER_SAMPLE - 0.26) / 0.03) ** 2)
CHIRP *= np.sin(np.pi * PER_SAMPLE * np.arange(20000))


def inspected(folder: Path, drive_V: Array, reading: Array) -> tuple[ColumnSummary, ...]:
    time_s = TIME_s[: len(drive_V)]
    (inspection,) = inspect_files([table(folder, HEADINGS, time_s, drive_V, reading)])
    return inspection.columns


@pytest.mark.parametrize(
    ("reading_um", "facts"),
    [
        (SINE + 1e-5 * NOISE, {"noise_rms": 1e-11, "step": 0.0, "clipped": 0.0}),
        (SINE + 1e-2 * NOISE, {"noise_rms": 1e-8, "step": 0.0, "clipped": 0.0}),
        (SINE + 1e-3 * NOISE + (np.arange(20000) % 500 == 0), {"noise_rms": 1e-9}),
        (np.sin(0.4 * np.pi * np.arange(20000)) + 1e-2 * NOISE, {"noise_rms": None}),
        (CHIRP + 2e-3 * NOISE, {"noise_rms": None}),
        (np.round(128.0 * SINE) / 128.0, {"step": 1e-6 / 128.0}),
        (0.02 * np.round(SINE / 0.02), {"step": 0.02e-6}),
        (np.clip(SINE, -0.9, 0.9), {"clipped": np.mean(np.abs(SINE) >= 0.9)}),
    ],
    ids=[
        *("little noise", "much noise", "spikes", "fast signal", "chirp"),
        *("fine converter", "coarse converter", "clipped"),
    ],
)
def test_an_inspection_states_noise_step_and_clipped_share(reading_um, facts, tmp_path):
    summary = inspected(tmp_path, 50.0 * SINE, reading_um)[2]
    for name, value in facts.items():
        expected = None if value is None else pytest.approx(value, rel=0.05)
        assert getattr(summary, name) == expected, name


def test_a_frozen_part_does_not_hide_the_noise(tmp_path):
    reading_um = np.where(TIME_s < 5.0, 0.0, 0.05 * TIME_s + 2e-3 * NOISE)
    assert inspected(tmp_path, 50.0 * SINE, reading_um)[2].noise_rms is not None


@pytest.mark.parametrize(
    "drive_V",
    [
        SINE,
        np.round(SINE, 2),
        np.concatenate([np.maximum(SINE, 0)[:6000], np.zeros(3000)]),
        np.repeat([0.0, 1, 2, 3, 2, 1, 0], 500),
        np.repeat([0.0, 1, 0, 1], 500),
        np.abs(np.arange(-5000, 5000) % 2000 - 1000) / 1000,
        np.zeros(100),
    ],
    ids=["sine", "coarse sine", "bursts from rest", "staircase", "steps", "triangle", "dead"],
)
def test_drives_with_constant_parts_are_not_clipped(drive_V, tmp_path):
    assert inspected(tmp_path, drive_V, NOISE[: len(drive_V)])[1].clipped == 0.0


def recording_of(tmp_path: Path, reading_um: Array, drive_V: Array) -> Recording:
    path = tmp_path / "sweep.csv"
    rows = zip(np.arange(len(drive_V)) / 1000.0, drive_V, reading_um, strict=True)
    lines = (f"{t:.3f},{u:.5f},{x:.5f}" for t, u, x in rows)
    path.write_text("time [s],voltage [V],displacement [um]\n" + "\n".join(lines) + "\n")
    return collect([path])[0]


def test_an_overflowing_reading_is_reported_with_its_row_and_refused(rng, tmp_path):
    drive_V = 50.0 * SINE
    reading_um = 20.0 * SINE + rng.normal(0, 2e-3, len(SINE))
    wrapped_um = np.where(reading_um > 15.0, reading_um - 35.0, reading_um)
    recording = recording_of(tmp_path, wrapped_um, drive_V)
    (statement,) = (s for s in recording.statements if s.quantity == "wrapped")
    first = int(np.flatnonzero(np.abs(np.diff(wrapped_um)) > 30.0)[0]) + 1
    assert f"row {first + 1}" in statement.text
    message = f"{recording.name}: column 3 'displacement [um]' jumps over its whole range"
    for verb in (piezoid.fit, piezoid.diagnose):
        with pytest.raises(RecordingError, match=re.escape(message)):
            verb(recording)


def test_a_slowly_overflowing_counter_is_refused(tmp_path):
    """Each of 160 codes lasts at least six samples, longer than the neighbours of a jump."""
    codes = np.mod(np.round(100.0 * SINE), 160)
    recording = recording_of(tmp_path, 0.1 * codes, 50.0 * SINE)
    with pytest.raises(RecordingError, match="jumps over its whole range"):
        piezoid.fit(recording)


@pytest.mark.parametrize("invalid_um", [0.0, 9999.0, -1.0])
def test_invalid_readings_and_steps_of_the_drive_are_no_overflow(invalid_um, rng, tmp_path):
    drive_V = 50.0 * SINE
    reading_um = 20.0 + 18.0 * SINE + rng.normal(0, 2e-3, len(SINE))
    reading_um[200:203] = reading_um[400] = reading_um[800:820] = invalid_um
    steps_V = np.sign(SINE) * 40.0
    answer_um = 0.4 * steps_V + 0.01 * SINE
    delayed_um = np.roll(answer_um, 3)  # a sensor that reads three samples later
    pairs = ((reading_um, drive_V), (answer_um, steps_V), (delayed_um, steps_V))
    for displacement_um, voltage_V in pairs:
        recording = recording_of(tmp_path, displacement_um, voltage_V)
        assert "wrapped" not in quantities_of(recording)


TRIANGLE_V = 5.0 * np.abs(np.arange(6000) % 2000 - 1000) / 1000 + 0.123
LEVEL_um = 8.0 / 4096


@pytest.mark.parametrize(
    "commanded_um",
    [
        LEVEL_um * np.round(1.7 * TRIANGLE_V / LEVEL_um),
        8.0 - 1.7 * TRIANGLE_V,
        np.roll(1.7 * TRIANGLE_V, 1),
        1.7 * TRIANGLE_V + 0.02 * TRIANGLE_V**2,
    ],
    ids=["grid of 12 bits", "falling", "one sample late", "polynomial"],
)
def test_a_command_logged_as_displacement_is_refused(commanded_um, tmp_path):
    recording = recording_of(tmp_path, commanded_um, TRIANGLE_V)
    assert "not_measured" in quantities_of(recording)
    with pytest.raises(RecordingError, match="nothing was measured"):
        piezoid.fit(recording)


def test_a_linear_stage_with_noise_or_a_single_branch_is_a_measurement(rng, tmp_path):
    noisy_um = 1.7 * TRIANGLE_V + rng.normal(0, 1e-3, len(TRIANGLE_V))
    coarse_um = LEVEL_um * np.round(noisy_um / LEVEL_um)
    for reading_um, drive_V in (
        (noisy_um, TRIANGLE_V),
        (coarse_um, TRIANGLE_V),
        (1.7 * TRIANGLE_V[:1000], TRIANGLE_V[:1000]),
    ):
        recording = recording_of(tmp_path, reading_um, drive_V)
        assert "not_measured" not in quantities_of(recording)
