"""Dead, clipped, wrapped and coarse channels, and the noise of a smooth one."""

import re
from pathlib import Path

import numpy as np
import pytest

import piezoid
from piezoid.errors import RecordingError
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import (
    clipped_samples,
    is_noise_hidden,
    noise_rms,
    step_size,
)

PHASE = 2 * np.pi * np.arange(20000) / 4000
SINE = np.sin(PHASE)


@pytest.mark.parametrize("noise", [1e-5, 1e-3, 1e-2])
def test_noise_on_a_smooth_signal_is_measured(noise, rng):
    assert noise_rms(SINE + rng.normal(0, noise, len(SINE))) == pytest.approx(noise, rel=0.05)


@pytest.mark.parametrize(("per_sample", "is_hidden"), [(1e-3, False), (0.2, True)])
def test_a_fast_signal_hides_the_noise(per_sample, is_hidden, rng):
    fast = np.sin(2 * np.pi * per_sample * np.arange(20000))
    assert is_noise_hidden(fast + rng.normal(0, 1e-2, len(fast))) is is_hidden


def test_a_chirp_through_a_resonance_hides_the_noise(rng):
    t = np.linspace(0.0, 1.0, 20000)
    per_sample = 0.45 * t  # to nine tenths of half the sampling rate
    amplitude = 0.003 + 1.0 / (1.0 + ((per_sample - 0.26) / 0.03) ** 2)
    chirp = amplitude * np.sin(np.pi * per_sample * 20000 * t)
    assert is_noise_hidden(chirp + rng.normal(0, 2e-3, len(chirp)))
    ramp = t + rng.normal(0, 2e-3, len(t))
    ramp[:5000] = 0.0  # a sensor that is frozen at first
    assert not is_noise_hidden(ramp)


def test_spikes_are_no_noise_and_a_continuous_signal_has_no_step(rng):
    values = SINE + rng.normal(0, 1e-3, len(SINE))
    values[::500] += 1
    assert noise_rms(values) == pytest.approx(1e-3, rel=0.05)
    assert step_size(SINE + rng.normal(0, 1e-3, len(SINE))) == 0


@pytest.mark.parametrize("step", [1 / 128, 0.02])
def test_a_converter_step_is_measured(step):
    assert step_size(step * np.round(SINE / step)) == pytest.approx(step, rel=1e-6)


def test_the_share_of_clipped_samples_is_measured(rng):
    noisy = SINE + rng.normal(0, 1e-4, len(SINE))
    clipped = np.clip(noisy, -0.9, 0.9)
    assert clipped_samples(clipped).mean() == pytest.approx(
        np.mean(np.abs(noisy) >= 0.9), rel=0.02
    )


@pytest.mark.parametrize(
    "values",
    [
        SINE,
        np.round(SINE, 2),
        np.round(SINE, 4),
        np.concatenate([np.maximum(SINE, 0)[:6000], np.zeros(3000)]),
        np.repeat([0.0, 1, 2, 3, 2, 1, 0], 500),
        np.repeat([0.0, 1, 0, 1], 500),
        np.abs(np.arange(-5000, 5000) % 2000 - 1000) / 1000,
        np.zeros(100),
    ],
    ids=[
        *("sine", "coarse sine", "fine sine", "bursts from rest"),
        *("staircase", "steps", "triangle", "dead"),
    ],
)
def test_drives_with_constant_parts_are_not_clipped(values):
    assert not clipped_samples(values, idle_value=0.0).any()


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
        assert "wrapped" not in {problem.quantity for problem in recording.statements}


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
    assert "not_measured" in {s.quantity for s in recording.statements}
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
        assert "not_measured" not in {s.quantity for s in recording.statements}
