"""Dynamics behind a known hysteresis are identified where they are excited, and only there."""

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
from tests.identification.hysteresis.stages import recording as recording_of
from tests.reports.known_stage import HYSTERESIS, axis_model, stage_model

RATE_Hz = 5000.0
MODE_Hz, DAMPING = 400.0, 0.05


def chirp(amplitude_V: float = 2.0, samples: int = 30000) -> Array:
    time_s = np.arange(samples) / RATE_Hz
    rate = np.log(1500.0 / 5.0) / time_s[-1]
    return 5.0 + amplitude_V * np.sin(2 * np.pi * 5.0 * np.expm1(rate * time_s) / rate)


def recorded(voltage_V: Array, rng: np.random.Generator, name: str = "chirp.csv") -> Recording:
    """Record hysteresis, one mode behind a hold, and 5 nm of noise."""
    static_m, _ = HYSTERESIS.run(voltage_V, HYSTERESIS.virgin_memory())
    mode = sample(resonance(MODE_Hz, DAMPING), RATE_Hz)
    rest_m = static_m[0]
    state, ringing_m = np.zeros(len(mode.A)), np.empty(len(static_m))
    for k, value in enumerate(static_m - rest_m):
        ringing_m[k] = (mode.C @ state + mode.D[:, 0] * value)[0]
        state = mode.A @ state + mode.B[:, 0] * value
    displacement_m = rest_m + ringing_m + 5e-9 * rng.standard_normal(len(ringing_m))
    return recording_of(voltage_V, displacement_m, name, RATE_Hz)


@pytest.fixture(scope="module")
def chirped() -> Recording:
    return recorded(chirp(), np.random.default_rng(41))


@pytest.fixture(scope="module")
def axis(chirped: Recording) -> AxisModel:
    return with_dynamics(axis_model(), [chirped], stated_Hz=400.0)


def test_a_mode_behind_large_hysteresis_is_identified(axis):
    dynamics = axis.dynamics
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


def test_a_mode_is_identified_with_a_drive_that_is_not_held():
    """With an assumed hold, the stage would respond too early."""
    oversampling, rig = 16, Rig(amplifier_bandwidth_Hz=2600.0, sensor_bandwidth_Hz=7700.0)
    fine_Hz = oversampling * RATE_Hz
    time_s, duration_s = np.arange(29_999 * oversampling + 1) / fine_Hz, 29_999 / RATE_Hz
    rate = np.log(1500.0 / 5.0) / duration_s
    voltage_V = 5.0 + 2.0 * np.sin(2 * np.pi * 5.0 * np.expm1(rate * time_s) / rate)
    driven_V = behind_pole(voltage_V, rig.amplifier_bandwidth_Hz, fine_Hz)
    static_m, _ = HYSTERESIS.run(driven_V, HYSTERESIS.virgin_memory())
    ringing_m = static_m[0] + through_mode(static_m - static_m[0], MODE_Hz, 0.5 / DAMPING, fine_Hz)
    reading_m = behind_pole(ringing_m, rig.sensor_bandwidth_Hz, fine_Hz)[::oversampling]
    noise_m = 5e-9 * np.random.default_rng(3).standard_normal(len(reading_m))
    recording = recording_of(voltage_V[::oversampling], reading_m + noise_m, "chirp.csv", RATE_Hz)
    dynamics = with_dynamics(replace(axis_model(), rig=rig), [recording]).dynamics
    assert dynamics.mode_frequency_Hz == pytest.approx([MODE_Hz], rel=0.01)
    assert dynamics.delay_s < 2e-6


def linear_sweep(low_Hz: float, high_Hz: float, amplitude_V: float, samples: int = 30000) -> Array:
    """Return a linear sweep about 5 V."""
    time_s = np.arange(samples) / RATE_Hz
    rate = (high_Hz - low_Hz) / time_s[-1]
    return 5.0 + amplitude_V * np.sin(2 * np.pi * (low_Hz + 0.5 * rate * time_s) * time_s)


LOOP = 5.0 - 4.5 * np.sin(2 * np.pi * 1.5 * np.arange(10000) / RATE_Hz)


@pytest.mark.parametrize(
    "drive_V",
    [linear_sweep(180.0, 900.0, 2.0), np.concatenate([LOOP, linear_sweep(5.0, 1500.0, 0.3)])],
    ids=["through the resonance only", "small, after a slow loop"],
)
def test_a_sweep_excites_a_mode_in_its_band(drive_V, rng):
    sweep = recorded(drive_V, rng, "sweep.csv")
    assert [recording.name for recording, _ in excites_dynamics([sweep], "x")] == ["sweep.csv"]
    dynamics = with_dynamics(axis_model(), [sweep]).dynamics
    strongest = int(np.abs(dynamics.mode_gain_m_per_V).argmax())
    assert dynamics.mode_frequency_Hz[strongest] == pytest.approx(MODE_Hz, rel=0.02)


@pytest.mark.parametrize("levels", [12, 40])
def test_stairs_noise_and_single_sines_are_not_sweeps(levels, rng):
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


def test_a_response_hidden_by_noise_is_not_fitted_and_the_reason_is_stated(chirped, rng):
    drive, displacement = chirped.channels
    noise = replace(displacement, values=1e-6 * rng.standard_normal(chirped.samples))
    fitted = with_dynamics(axis_model(), [replace(chirped, channels=(drive, noise))])
    assert fitted.dynamics is None
    assert len(fitted.dynamics_remarks) == 1
    assert "0 of 2046 lines are coherent" in fitted.dynamics_remarks[0]


def test_a_resonance_that_cannot_be_fitted_is_stated_with_its_reason(chirped):
    drive, displacement = chirped.channels
    advanced = replace(displacement, values=np.roll(displacement.values, -1))  # not causal
    fitted = with_dynamics(axis_model(), [replace(chirped, channels=(drive, advanced))])
    assert fitted.dynamics is None
    assert fitted.unfitted_resonance_Hz == pytest.approx(MODE_Hz, rel=0.02)
    (statement,) = [fact for fact in fit_statements(fitted) if fact.quantity == "dynamics"]
    assert statement.level is Level.ACTION
    for words in ("shows a resonance", "could not be fitted", "delay lies on 0"):
        assert words in statement.text


def test_a_model_with_dynamics_survives_its_file_bit_by_bit(axis):
    content = write_model(stage_model(axis))
    assert write_model(read_model(content)) == content
    assert read_model(content)["x"].dynamics is not None
    assert read_model(content)["x"].bandwidth == axis.bandwidth
    assert axis.bandwidth.kind == "resonance"
    assert axis.bandwidth.text in axis.dynamics_remarks


def test_the_report_shows_gain_phase_coherence_and_poles(axis, chirped):
    page = render(Page(model=stage_model(axis), recordings=[chirped]))
    for words in ('id="dynamics"', "Axis x: phase", "Axis x: coherence", "Axis x: poles"):
        assert words in page
    assert axis.bandwidth.text in page


@pytest.mark.usefixtures("one_order")
def test_sines_that_determine_no_mode_are_named():
    lab = read_lab(piezoid_datasets.LAB)
    (rates,) = collect(piezoid_datasets.recordings()[2:3], lab).recordings
    axis = estimate_axis([rates], "x", rig_of(lab, "x"), orders=((4, 1),))
    fitted = with_dynamics(axis, [rates])
    assert fitted.dynamics is None
    assert fitted.dynamics_remarks
    assert all(rates.name in remark for remark in fitted.dynamics_remarks)
