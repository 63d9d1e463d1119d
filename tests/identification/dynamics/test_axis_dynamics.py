"""Dynamics behind a known hysteresis: found where they are excited, and only there."""

from dataclasses import replace

import numpy as np
import pytest

import piezoid_datasets
from piezoid.diagnosis.signals import mode as through_mode
from piezoid.formatting import with_unit
from piezoid.identification.dynamics.axis_dynamics import with_dynamics
from piezoid.identification.dynamics.behind_hysteresis import excites_dynamics
from piezoid.identification.fit import rig_of
from piezoid.identification.fit_statements import fit_statements
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig, behind_pole
from piezoid.identification.model import AxisModel
from piezoid.identification.store import read_model, write_model
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import resonance, sample
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid.records.recording import Recording
from piezoid.statement import Level
from piezoid_reports.page import Page
from piezoid_reports.render import render
from tests.identification.hysteresis.stages import recording as made_recording
from tests.reports.known_stage import HYSTERESIS, axis_model, stage_model

RATE_Hz = 5000.0
MODE_Hz, DAMPING = 400.0, 0.05


def chirp(amplitude_V: float = 2.0, samples: int = 30000) -> Array:
    time_s = np.arange(samples) / RATE_Hz
    rate = np.log(1500.0 / 5.0) / time_s[-1]
    return 5.0 + amplitude_V * np.sin(2 * np.pi * 5.0 * np.expm1(rate * time_s) / rate)


def recorded(voltage_V: Array, rng: np.random.Generator, name: str = "chirp.csv") -> Recording:
    """Hysteresis, then one mode behind a hold, then 5 nm of noise."""
    moved_m, _ = HYSTERESIS.run(voltage_V, HYSTERESIS.virgin_memory())
    mode = sample(resonance(MODE_Hz, DAMPING), RATE_Hz)
    rest_m = moved_m[0]
    state, out = np.zeros(len(mode.A)), np.empty(len(moved_m))
    for k, value in enumerate(moved_m - rest_m):
        out[k] = (mode.C @ state + mode.D[:, 0] * value)[0]
        state = mode.A @ state + mode.B[:, 0] * value
    displacement_m = rest_m + out + 5e-9 * rng.standard_normal(len(out))
    return made_recording(voltage_V, displacement_m, name, RATE_Hz)


@pytest.fixture(scope="module")
def chirped() -> Recording:
    return recorded(chirp(), np.random.default_rng(41))


@pytest.fixture(scope="module")
def axis(chirped: Recording) -> AxisModel:
    return with_dynamics(axis_model(), [chirped], stated_Hz=400.0)


def test_a_mode_behind_hysteresis_of_large_amplitude_is_found(axis):
    dynamics = axis.dynamics
    assert dynamics is not None
    strongest = int(np.abs(dynamics.mode_gain_m_per_V).argmax())
    # The windows widen a resonance of 40 Hz by a few of their 1.2 Hz.
    assert dynamics.mode_frequency_Hz[strongest] == pytest.approx(MODE_Hz, rel=0.01)
    assert dynamics.mode_damping[strongest] == pytest.approx(DAMPING, rel=0.2)
    low_Hz, high_Hz = dynamics.band_Hz
    assert low_Hz < MODE_Hz < high_Hz
    assert any(
        remark.startswith("chirp.csv") and with_unit(high_Hz, "Hz") in remark
        for remark in axis.verdict.remarks
    )


def test_the_mode_is_told_where_a_generator_drives_the_stage_between_samples():
    """The stage seems early where a hold is assumed."""
    finer, rig = 16, Rig(amplifier_bandwidth_Hz=2600.0, sensor_bandwidth_Hz=7700.0)
    fine_Hz = finer * RATE_Hz
    time_s, last_s = np.arange(29_999 * finer + 1) / fine_Hz, 29_999 / RATE_Hz
    rate = np.log(1500.0 / 5.0) / last_s
    voltage_V = 5.0 + 2.0 * np.sin(2 * np.pi * 5.0 * np.expm1(rate * time_s) / rate)
    driven_V = behind_pole(voltage_V, rig.amplifier_bandwidth_Hz, fine_Hz)
    moved_m, _ = HYSTERESIS.run(driven_V, HYSTERESIS.virgin_memory())
    rung_m = moved_m[0] + through_mode(moved_m - moved_m[0], MODE_Hz, 0.5 / DAMPING, fine_Hz)
    read_m = behind_pole(rung_m, rig.sensor_bandwidth_Hz, fine_Hz)[::finer]
    noise_m = 5e-9 * np.random.default_rng(3).standard_normal(len(read_m))
    recording = made_recording(voltage_V[::finer], read_m + noise_m, "chirp.csv", RATE_Hz)
    dynamics = with_dynamics(replace(axis_model(), rig=rig), [recording]).dynamics
    assert dynamics is not None
    assert dynamics.mode_frequency_Hz == pytest.approx([MODE_Hz], rel=0.01)
    assert dynamics.delay_s < 2e-6


def swept(low_Hz: float, high_Hz: float, amplitude_V: float, samples: int = 30000) -> Array:
    """A linear sweep about 5 V."""
    time_s = np.arange(samples) / RATE_Hz
    rate = (high_Hz - low_Hz) / time_s[-1]
    return 5.0 + amplitude_V * np.sin(2 * np.pi * (low_Hz + 0.5 * rate * time_s) * time_s)


LOOP = 5.0 - 4.5 * np.sin(2 * np.pi * 1.5 * np.arange(10000) / RATE_Hz)


@pytest.mark.parametrize(
    "drive_V",
    [swept(180.0, 900.0, 2.0), np.concatenate([LOOP, swept(5.0, 1500.0, 0.3)])],
    ids=["through the resonance alone", "small, behind a slow loop"],
)
def test_a_sweep_excites_the_mode_it_passes(drive_V, rng):
    sweep = recorded(drive_V, rng, "sweep.csv")
    assert [recording.name for recording, _ in excites_dynamics([sweep], "x")] == ["sweep.csv"]
    dynamics = with_dynamics(axis_model(), [sweep]).dynamics
    assert dynamics is not None
    strongest = int(np.abs(dynamics.mode_gain_m_per_V).argmax())
    assert dynamics.mode_frequency_Hz[strongest] == pytest.approx(MODE_Hz, rel=0.02)


@pytest.mark.parametrize("levels", [12, 40])
def test_neither_stairs_nor_a_noisy_slow_drive_nor_one_fast_sine_are_sweeps(levels, rng):
    time_s = np.arange(30000) / RATE_Hz
    climb = 1.0 - np.abs(1.0 - np.arange(30000) / 15000.0)
    slow = 5.0 + 4.0 * np.sin(2 * np.pi * 2.0 * time_s)
    drives = {
        "stairs": 10.0 * np.round(levels * climb) / levels,
        "monitored": slow + 0.02 * rng.standard_normal(30000),
        "sine": 5.0 + 4.0 * np.sin(2 * np.pi * 120.0 * time_s),
        "triangle": 10.0 * np.abs(2.0 * ((20.0 * time_s) % 1.0) - 1.0),
        "slow": 10.0 * np.abs(2.0 * ((3.0 * time_s) % 1.0) - 1.0),
    }
    for name, drive in drives.items():
        assert excites_dynamics([recorded(drive, rng, name)], "x") == (), name
    slow_axis = with_dynamics(axis_model(), [recorded(drives["slow"], rng)])
    assert slow_axis.dynamics is None
    assert slow_axis.dynamics_remarks == ()


def test_where_noise_covers_everything_it_is_said_that_nothing_was_fitted(chirped, rng):
    drive, moved = chirped.channels
    noise = replace(moved, values=1e-6 * rng.standard_normal(chirped.samples))
    found = with_dynamics(axis_model(), [replace(chirped, channels=(drive, noise))])
    assert found.dynamics is None
    assert len(found.dynamics_remarks) == 1
    assert "0 of 2046 lines are coherent" in found.dynamics_remarks[0]


def test_a_resonance_that_cannot_be_fitted_is_stated_with_the_reason(chirped):
    drive, moved = chirped.channels
    early = replace(moved, values=np.roll(moved.values, -1))  # no held drive is ahead of itself
    found = with_dynamics(axis_model(), [replace(chirped, channels=(drive, early))])
    assert found.dynamics is None
    assert found.unfitted_resonance_Hz == pytest.approx(MODE_Hz, rel=0.02)
    (statement,) = [fact for fact in fit_statements(found) if fact.quantity == "dynamics"]
    assert statement.level is Level.ACTION
    for words in ("shows a resonance", "could not be fitted", "delay lies on 0"):
        assert words in statement.text


def test_the_model_with_dynamics_comes_back_to_the_last_bit(axis):
    content = write_model(stage_model(axis))
    assert write_model(read_model(content)) == content
    assert read_model(content)["x"].dynamics is not None
    assert read_model(content)["x"].bandwidth == axis.bandwidth
    assert axis.bandwidth is not None
    assert axis.bandwidth.kind == "resonance"
    assert axis.bandwidth.text in axis.dynamics_remarks


def test_the_report_shows_gain_phase_coherence_and_poles(axis, chirped):
    page = render(Page(model=stage_model(axis), recordings=[chirped]))
    for words in ('id="dynamics"', "Axis x: phase", "Axis x: coherence", "Axis x: poles"):
        assert words in page
    assert axis.bandwidth is not None
    assert axis.bandwidth.text in page


@pytest.mark.usefixtures("one_order")
def test_sines_that_determine_no_mode_are_said_to_determine_none():
    lab = read_lab(piezoid_datasets.LAB)
    (rates,) = collect(piezoid_datasets.recordings()[2:3], lab).recordings
    axis = estimate_axis([rates], "x", rig_of(lab, "x"), orders=((4, 1),))
    found = with_dynamics(axis, [rates])
    assert found.dynamics is None
    assert found.dynamics_remarks
    assert all(rates.name in remark for remark in found.dynamics_remarks)
