"""Waves in a residual of known content: their frequency, their p-value and their profile."""

from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.coordinate_scores import Residual, score_coordinates, strongest_peaks
from piezoid.diagnosis.residual_coordinates import wave_basis
from piezoid.diagnosis.residual_structure import ResidualStructure
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.structure_findings import structure_finding
from piezoid.numerics.arrays import Array

from .bench import view_of_recordings
from .play_stage import NOISE_m, STROKE_m, healthy, recording, stroke_fraction

SAMPLES = 9000
DRIVEN = np.array([40.4, 75.4, 119.4, 160.4])  # periods of the recording


@cache
def view_of_tones() -> View:
    """Return a view of one recording whose drive has four tones."""
    time = np.arange(SAMPLES) / SAMPLES
    field = np.sin(2.0 * np.pi * np.outer(time, DRIVEN) + np.arange(4) ** 2).sum(axis=1)
    field *= 0.9 / np.abs(field).max()
    noise_m = np.random.default_rng(1).normal(0.0, NOISE_m, SAMPLES)
    reading_m = STROKE_m * stroke_fraction(field) + noise_m
    return view_of_recordings([recording("sweep", reading_m, field)])


def residual_with(view: View, values: Array) -> Residual:
    """Return a residual of these values in which no hysteresis is fitted."""
    null = Null(columns=np.ones((len(values), 1)), response=values, block=view.block)
    return Residual(view=view, null=null)


def frequency_of(tones: dict[float, float]) -> float | None:
    """Return the frequency of the residual, in periods of the recording.

    tones  (periods) -> amplitude; the residual is their sum and white noise of rms 1
    """
    view = view_of_tones()
    (track,) = view.tracks
    values = np.random.default_rng(2).normal(size=len(track.rows))
    for periods, amplitude in tones.items():
        values += amplitude * np.sin(2.0 * np.pi * periods * track.rows / SAMPLES + periods)
    scores = score_coordinates(residual_with(view, values))
    waves = [score.basis.per_unit for score in scores if score.coordinate == "frequency"]
    return waves[0] * SAMPLES / track.rate_Hz if waves else None


def test_a_tone_is_found_beside_stronger_lines_of_the_motion():
    """The hysteresis of the model may miss each line of the motion."""
    lines = dict.fromkeys(DRIVEN.tolist(), 1.0)
    assert frequency_of(lines) is None
    assert frequency_of({**lines, 210.3: 0.6}) == pytest.approx(210.3, abs=0.2)


@pytest.mark.parametrize("distance", [-1.2, 1.2])
def test_a_tone_more_than_one_period_from_a_line_of_the_motion_is_found(distance):
    tone = DRIVEN[0] + distance
    assert frequency_of({tone: 1.0}) == pytest.approx(tone, abs=0.2)


def test_the_strongest_peaks_are_separate_lines_from_the_first_line_on():
    """In white noise of median power 1 a line exceeds the power P with probability 2^-P."""
    spectrum = np.ones(200)
    spectrum[[0, 1, 60, 199]] = 40.0, 30.0, 20.0, 10.0
    peaks = strongest_peaks(spectrum)
    assert [(power, index) for power, _, index in peaks] == [(40.0, 0), (20.0, 60), (10.0, 199)]
    p_values = [p_value for _, p_value, _ in peaks]
    assert p_values == pytest.approx([200 * 2.0**-40, 200 * 2.0**-20, 200 * 2.0**-10])
    assert strongest_peaks(np.zeros(200)) == []


@pytest.mark.parametrize("polarity", [1, -1])
def test_the_profile_of_a_wave_begins_at_its_phase_in_every_recording(polarity):
    view, frequency_Hz, amplitude = healthy(), 3.7, 0.02
    time_s = tuple(track.time_s for track in view.tracks)
    phases = zip((0.4, 1.9, 4.0), view.tracks, strict=True)
    wave = np.concatenate(
        [np.cos(2.0 * np.pi * frequency_Hz * t.time_s[t.rows] - phase) for phase, t in phases]
    )
    residual = residual_with(view, amplitude * wave)
    basis = wave_basis(view, "frequency", time_s, frequency_Hz, "s", harmonics=2)
    score = residual.score(basis)
    structure = ResidualStructure(
        score=score,
        curve=tuple(basis.curve(k, score.coefficients) for k in range(len(view.tracks))),
        share=1.0,
        residual=residual.values,
        view=view,
        healthy_p_value=0.01,
    )
    finding = structure_finding(
        structure,
        before_m=1e-7,
        after_m=1e-8,
        scale_m=polarity * view.half_stroke_m,
        middle_m=0.0,
    )
    profile, height_m = finding.seen, amplitude * view.half_stroke_m
    expected_m = polarity * height_m * np.cos(2.0 * np.pi * np.array(profile.place))
    assert np.allclose(profile.fitted_m, expected_m, atol=0.02 * height_m)
    assert np.allclose(profile.median_m, expected_m, atol=0.02 * height_m)
    assert finding.parameters == {"frequency_Hz": frequency_Hz}
    assert finding.size.value == pytest.approx(1e9 * height_m / np.sqrt(2.0), rel=0.01)
