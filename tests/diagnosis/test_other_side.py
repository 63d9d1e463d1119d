"""A filter in front of the walls is told from one behind them; so is a gain between recordings."""

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
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording

from .bench import thinned, view_of_recordings
from .play_stage import NOISE_m, STROKE_m, clean, drive, moved, recording

pytestmark = pytest.mark.slow

KINDS = ("sweep", "walk", "waves")
ORDER = ("sweep", "sweep", "waves")
LAG_s = 1.5e-3
EVERY = 6  # samples


def behind(signal: Array, rate_Hz: float) -> Array:
    """Return a signal behind a pole, straight between samples."""
    pole = np.exp(-1.0 / (rate_Hz * LAG_s))
    part = LAG_s * rate_Hz * (1.0 - pole)
    moved_on = lfilter([1.0 - part, part - pole], [1.0, -pole], signal - signal[0])
    return moved_on + signal[0]


def noisy(reading_m: Array) -> Array:
    return reading_m + np.random.default_rng(3).normal(0.0, NOISE_m, len(reading_m))


def causes_in(recordings: Sequence[Recording]) -> tuple[Candidate, ...]:
    return search(view_of_recordings(thinned(recordings, EVERY), Lab())).causes


def test_a_lag_in_front_of_the_walls_is_named_alone_and_sized() -> None:
    """A lag behind them: test_hidden_effects.py."""
    recordings = []
    for kind in KINDS:
        rate_Hz, field = drive(kind)
        recordings.append(recording(kind, noisy(STROKE_m * moved(behind(field, rate_Hz)))))
    lag, initial_state = causes_in(recordings)
    assert (lag.effect.name, initial_state.effect.name) == ("lag", "initial_state")
    size = size_of(lag)
    low_us, high_us = size.ci95
    assert low_us < 1e6 * LAG_s < high_us
    assert size.value == pytest.approx(1e6 * LAG_s, rel=0.03)


def with_gains(*gains: float) -> list[str]:
    """Return what is named of a sweep, the same again, and waves, at gains of their own."""
    made = [
        recording(kind, clean(kind)[2] * gain) for kind, gain in zip(ORDER, gains, strict=True)
    ]
    numbered = [replace(one, name=f"{k}") for k, one in enumerate(made)]
    return [
        f"{cause.effect.name} {size_of(cause).value:.1f}"
        for cause in causes_in(numbered)
        if cause.effect.name != "initial_state"
    ]


def test_a_gain_that_changed_between_two_recordings_is_named_and_sized() -> None:
    assert with_gains(1.0, 1.02, 1.02) == ["gain_change 2.0"]


def test_the_instant_of_a_gain_change_is_found_in_its_recording() -> None:
    """Instants tried at larger distances missed changes beside other effects."""
    instant, recordings = 0.607, []
    for kind in KINDS:
        moved_m = noisy(clean(kind)[2])
        if kind == "waves":
            moved_m[int(instant * len(moved_m)) :] *= 0.97
        recordings.append(recording(kind, moved_m))
    result = score_test(gain_change.EFFECT, view_of_recordings(thinned(recordings, EVERY), Lab()))
    assert result is not None
    assert result.trial.parameters["track"] == 2.0
    assert result.trial.parameters["place"] == pytest.approx(instant, abs=0.02)
    guess = initial_guess(gain_change.EFFECT, result.trial, -0.03)
    for steps in (-1000.0, 1000.0):  # a search that runs away leaves data on both sides
        assert 0.05 < with_step(guess, "place", steps).parameters["place"] < 0.95


def test_a_gain_of_one_recording_alone_is_no_change_at_an_instant() -> None:
    assert not any(name.startswith("gain_change") for name in with_gains(1.0, 1.0, 1.02))
