"""Observations that resemble a fault of the data or a dynamic effect, and are neither."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from piezoid import diagnose, read
from piezoid.diagnosis.diagnosis import Finding
from piezoid.diagnosis.effects import mains_interference
from piezoid.diagnosis.identified_modes import with_modes
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.signals import mode
from piezoid.identification.dynamics.bandwidth import BandwidthVerdict
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from piezoid.records.invalid_samples import find_invalid_readings
from tests.diagnosis.ceramic import bouc_wen_um
from tests.records.responses import write_csv
from tests.reports.known_diagnosis import diagnosed
from tests.reports.known_stage import axis_model

from .bench import view_of_recordings
from .play_stage import NOISE_m, STROKE_m, drive, recording
from .play_stage import stroke_fraction as plays

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")

HOLD, RAMP = 40, 6  # samples
LEVELS = 60


def staircase_readings() -> tuple[np.ndarray, np.ndarray]:
    """Return drive and readings of a staircase of held levels, rounded to 1 nm."""
    rng = np.random.default_rng(11)
    levels_V = np.concatenate([[0.0, 100.0, 0.0], rng.uniform(0.0, 100.0, LEVELS)])
    pieces = [np.full(HOLD, levels_V[0])]
    for start_V, end_V in itertools.pairwise(levels_V):
        ramp_V = np.linspace(start_V, end_V, RAMP + 1)[1:]
        pieces += [ramp_V, np.full(HOLD, end_V)]
    drive_V = np.concatenate(pieces)
    reading_um = bouc_wen_um(drive_V) + rng.normal(0.0, 2e-3, len(drive_V))
    return drive_V, np.round(reading_um, 3)


@pytest.mark.slow
def test_held_levels_have_neither_invalid_readings_nor_outliers():
    """Equal readings at the end of a hold are measurements."""
    drive_V, reading_um = staircase_readings()
    assert find_invalid_readings(reading_um, drive_V) == ()
    time_s = np.arange(len(drive_V)) / 5000.0
    levels = diagnose(
        [from_arrays(time_s=time_s, voltage_V=drive_V, displacement_m=1e-6 * reading_um)]
    )
    assert "outliers" not in levels.names
    assert not any("single readings" in remark for remark in levels.model.verdict.remarks)


def test_hum_near_a_harmonic_of_the_drive_is_a_line_and_states_the_clock_error(tmp_path):
    time_s = np.arange(12000) / 2000.0
    drive_V = 50.0 * (1.0 - np.cos(2.0 * np.pi * time_s))
    hum_um = 0.02 * np.sin(2.0 * np.pi * 50.18 * time_s + 0.4)
    noise_um = np.random.default_rng(2).normal(0.0, 4e-3, len(time_s))
    reading_um = bouc_wen_um(drive_V) + hum_um + noise_um
    path = tmp_path / "hum.csv"
    write_csv(path, "time [s],voltage [V],displacement [um]", time_s, drive_V, reading_um)
    view = view_of_recordings(read(path).recordings)
    test = score_test(mains_interference.EFFECT, view)
    assert test.trial.parameters["frequency_Hz"] == pytest.approx(50.18, abs=0.03)
    assert test.cv.gain > 0.3
    note = mains_interference.EFFECT.note(test.trial.parameters)
    assert "the clock of the file is 0.3" in note


TONES_Hz = np.unique(np.round(np.geomspace(2.0, 130.0, 14)))


def dahl(field: Array) -> Array:
    """Return a response dominated by friction: the gain of fast small tones is different."""
    state, out = 0.0, np.empty(len(field))
    for i, (u, step) in enumerate(zip(field, np.diff(field, prepend=field[0]), strict=True)):
        state += step - 4.0 * abs(step) * state
        out[i] = 0.6 * u + 0.9 * state
    return out


def driven_by_tones(law: Callable[[Array], Array], *, rings: bool) -> View:
    """Return the view of a sweep and tones up to 130 Hz of a stage with a mode at 160 Hz."""
    rate_Hz, (_, sweep) = 4000.0, drive("sweep")
    time_s, rng = np.arange(len(sweep)) / rate_Hz, np.random.default_rng(2)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(TONES_Hz))
    tones = (TONES_Hz**-0.5) @ np.sin(2.0 * np.pi * np.outer(TONES_Hz, time_s) + phases[:, None])
    tones *= 0.9 / np.abs(tones).max()
    response = law(tones)
    if rings:
        response = mode(response, 160.0, 30.0, rate_Hz)
    noise_m = rng.normal(0.0, NOISE_m, (2, len(sweep)))
    recordings = (
        recording("sweep", STROKE_m * law(sweep) + noise_m[0], sweep),
        recording("waves", STROKE_m * response + noise_m[1], tones),
    )
    return view_of_recordings(recordings)


def resonance_of(view: View, ratio: float, peak_Hz: float = 130.0) -> Finding | None:
    """Return the resonance finding of a gain that rises to this ratio at the last tone."""
    rising = BandwidthVerdict(
        kind="undecided",
        stated_Hz=None,
        fallen_Hz=None,
        phase_interval_deg=None,
        peak_ratio=ratio,
        peak_Hz=peak_Hz,
        highest_Hz=135.0,
        text="",
    )
    model = replace(axis_model(), dynamics=None, bandwidth=rising)
    findings = with_modes(diagnosed(), model, (), view).findings
    return next((candidate for candidate in findings if candidate.effect == "resonance"), None)


@pytest.mark.parametrize("law", [dahl, plays], ids=["dahl", "plays"])
def test_a_gain_that_rises_to_the_end_of_the_band_is_a_resonance_beyond_it(law):
    view, ratio = driven_by_tones(law, rings=True), 1.0 / (1.0 - (130.0 / 160.0) ** 2)
    finding = resonance_of(view, ratio)
    low_Hz, high_Hz = finding.size.ci95
    assert finding.size.value == pytest.approx(160.0)
    assert low_Hz < 160.0 < high_Hz
    assert "320 Hz" in finding.next_experiment
    for implausible_ratio in (1.1, 24.0):  # flat; noise that grows with frequency
        assert resonance_of(view, implausible_ratio) is None


@pytest.mark.parametrize("law", [dahl, plays], ids=["dahl", "plays"])
def test_a_gain_that_rises_by_hysteresis_is_not_a_resonance(law):
    """The gain rises relative to the model; a wider class of hysteresis represents the tones."""
    assert resonance_of(driven_by_tones(law, rings=False), 2.0) is None


def test_a_gain_at_a_frequency_without_excitation_is_not_a_resonance():
    """All motion at this frequency is noise, which no hysteresis represents."""
    view = driven_by_tones(dahl, rings=True)
    for peak_Hz in (171.0, 184.0, 250.0, 310.0):
        assert resonance_of(view, 1.5, peak_Hz) is None
