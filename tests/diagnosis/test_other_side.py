"""Lags of the drive, and gain changes between recordings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.diagnosis.candidate import Candidate, size_of
from piezoid.diagnosis.effects import gain_change
from piezoid.diagnosis.refinement import initial_guess, with_step
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.selection import search
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

from .bench import thinned, view_of_recordings
from .play_stage import NOISE_m, STROKE_m, clean, drive, recording, stroke_fraction

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("few_rows")]

KINDS = ("sweep", "walk", "waves")
ORDER = ("sweep", "sweep", "waves")
LAG_s = 1.5e-3
EVERY = 6  # samples


def behind_lag(signal: Array, rate_Hz: float) -> Array:
    """Return a signal behind a pole, linear between samples."""
    pole = np.exp(-1.0 / (rate_Hz * LAG_s))
    share = LAG_s * rate_Hz * (1.0 - pole)
    lagged = lfilter([1.0 - share, share - pole], [1.0, -pole], signal - signal[0])
    return lagged + signal[0]


def noisy(reading_m: Array) -> Array:
    return reading_m + np.random.default_rng(3).normal(0.0, NOISE_m, len(reading_m))


def causes_in(recordings: Sequence[Recording]) -> tuple[Candidate, ...]:
    return search(view_of_recordings(thinned(recordings, EVERY))).causes


def test_a_lag_of_the_drive_is_named_alone_and_sized():
    """Lag of the hysteresis: test_hidden_effects.py."""
    recordings = []
    for kind in KINDS:
        rate_Hz, field = drive(kind)
        recordings.append(
            recording(kind, noisy(STROKE_m * stroke_fraction(behind_lag(field, rate_Hz))))
        )
    lag, initial_state = causes_in(recordings)
    assert (lag.effect.name, initial_state.effect.name) == ("lag", "initial_state")
    size = size_of(lag)
    low_us, high_us = size.ci95
    assert low_us < 1e6 * LAG_s < high_us
    assert size.value == pytest.approx(1e6 * LAG_s, rel=0.03)


def with_gains(*gains: float) -> list[str]:
    """Return the causes in two equal sweeps and waves with these gains."""
    recordings = [
        recording(kind, clean(kind)[2] * gain) for kind, gain in zip(ORDER, gains, strict=True)
    ]
    numbered = [replace(recording, name=f"{k}") for k, recording in enumerate(recordings)]
    return [
        f"{cause.effect.name} {size_of(cause).value:.1f}"
        for cause in causes_in(numbered)
        if cause.effect.name != "initial_state"
    ]


def test_a_gain_change_between_two_recordings_is_named_and_sized():
    assert with_gains(1.0, 1.02, 1.02) == ["gain_change 2.0"]


@pytest.mark.parametrize("kind", ["sweep", "waves"])
def test_the_instant_of_a_gain_change_in_a_single_recording_is_found(kind):
    """The class of the search absorbs a step of the gain at any other instant."""
    instant, displacement_m = 0.607, noisy(clean(kind)[2])
    displacement_m[int(instant * len(displacement_m)) :] *= 0.97
    view = view_of_recordings(thinned([recording(kind, displacement_m)], EVERY))
    result = score_test(gain_change.EFFECT, view)
    assert result.trial.parameters["place"] == pytest.approx(instant, abs=2e-3)
    assert result.cv.coefficient[0] == pytest.approx(-0.03, abs=0.004)
    guess = initial_guess(gain_change.EFFECT, result.trial, -0.03)
    for steps in (-1000.0, 1000.0):  # a divergent search keeps data on both sides
        assert 0.05 < with_step(guess, "place", steps).parameters["place"] < 0.95


def test_a_gain_of_the_last_recording_only_is_not_a_gain_change():
    assert not any(name.startswith("gain_change") for name in with_gains(1.0, 1.0, 1.02))
