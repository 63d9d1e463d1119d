"""Sizes of effects agree with the values that were simulated."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

import piezoid
from piezoid.diagnosis.candidate import Candidate, evaluate, size_of
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import (
    amplifier_saturation,
    creep,
    cross_coupling,
    delay,
    sensor_periodic_error,
)
from piezoid.diagnosis.refinement import SelectedEffect, initial_guess, refine, with_effects
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import ScoreTest, score_test
from piezoid.diagnosis.signals import with_displacement
from piezoid.records.recording import Channel, Quantity
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign

from .bench import read_campaign, thinned, view_of_recordings
from .play_recordings import with_another_axis
from .play_stage import recording

pytestmark = pytest.mark.slow


def clipped_percent(campaign: Campaign) -> float:
    """Return the larger fraction of the commanded range beyond a limit."""
    gain = campaign.rig.amplifier_gain_V_per_V
    low_V = min(gain * float(rows.run.command_V.min()) for rows in campaign.recordings)
    high_V = max(gain * float(rows.run.command_V.max()) for rows in campaign.recordings)
    (effect,) = campaign.answer.effects
    above_V = high_V - float(effect.numbers.get("high_V", high_V))
    below_V = float(effect.numbers.get("low_V", low_V)) - low_V
    return 100.0 * max(above_V, below_V) / (high_V - low_V)


def refitted(effect: Effect, view: View) -> tuple[ScoreTest, Candidate]:
    """Return the score test of an effect and the refitted candidate."""
    test = score_test(effect, view)
    assert test is not None
    start = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
    (selected,), refitted_view = refine([start], view)
    return test, evaluate(selected, refitted_view, view, test=test)


@cache
def clipping_cause(seed: int) -> tuple[Campaign, ScoreTest, Candidate]:
    """Return a stage with a clipping amplifier, the score test, and the refitted candidate."""
    campaign = draw_campaign(
        seed, truth="preisach", effects=("amplifier_saturation",), plans=("sweep", "check")
    )
    view = view_of_recordings(*read_campaign(campaign))
    return campaign, *refitted(amplifier_saturation.EFFECT, view)


@pytest.mark.parametrize("seed", [2, 3], ids=["above", "on both sides"])
def test_the_size_of_clipping_is_the_fraction_of_the_drive_range_that_is_cut_off(seed):
    campaign, _, cause = clipping_cause(seed)
    size, expected = size_of(cause), clipped_percent(campaign)
    assert cause.is_significant
    assert expected > 1.0
    assert size.value == pytest.approx(expected, rel=0.1)
    low, high = size.ci95
    assert 0.0 < low < expected < high < 1.3 * expected


RATE_Hz = 100.0
EVERY = 3  # samples: the stage does not depend on time
PER_DECADE = 12  # nodes of the quadrature
TILT = 0.15  # of the spectrum of creep, for each decade of time


def creeping(response_m: np.ndarray, tilt: float) -> np.ndarray:
    """Return relaxations from 10 ms to three hours, one step in the decade about 10 s."""
    total = np.zeros_like(response_m)
    for decade in -2.0 + (np.arange(6 * PER_DECADE) + 0.5) / PER_DECADE:
        pole = np.exp(-1.0 / (RATE_Hz * 10.0**decade))
        share = 1.0 + tilt * (decade - 1.0)
        total += lfilter([share * (1.0 - pole)], [1.0, -pole], response_m)
    return total / PER_DECADE


def plays(drive_V: np.ndarray) -> np.ndarray:
    states, response = np.zeros(5), np.empty(len(drive_V))
    widths, weights = np.array([0.0, 5.0, 15.0, 30.0, 50.0]), np.array([0.7, 0.1, 0.1, 0.06, 0.04])
    for i, u in enumerate(drive_V):
        states = np.clip(states, u - widths, u + widths)
        response[i] = weights @ states
    return 1e-8 * response


def staircase(rng: np.random.Generator, hold_s: float) -> np.ndarray:
    levels = np.concatenate([[0.0], rng.uniform(0.0, 100.0, 8)])
    rise, hold = np.linspace(0.0, 1.0, int(RATE_Hz / 2)), np.ones(int(hold_s * RATE_Hz))
    steps = [a + (b - a) * np.concatenate([rise, hold]) for a, b in pairwise(levels)]
    return np.concatenate(steps)


def test_the_size_of_creep_is_the_response_to_a_step_in_the_decade_about_ten_seconds():
    """A spectrum assumed flat is estimated 14 % too low."""
    hold_s = 3.0
    rng = np.random.default_rng(int(hold_s))
    time_s = np.arange(int(20 * RATE_Hz)) / RATE_Hz
    loops_V = 50.0 - 50.0 * np.cos(np.pi * time_s) * np.linspace(1.0, 0.3, len(time_s))
    recordings = []
    for drive_V in (staircase(rng, hold_s), loops_V, staircase(rng, hold_s)):
        static_m = plays(drive_V)
        noise_m = rng.normal(0.0, 0.3e-9, len(static_m))
        recordings.append(
            piezoid.from_arrays(
                time_s=np.arange(len(drive_V)) / RATE_Hz,
                voltage_V=drive_V,
                displacement_m=static_m + 0.01 * creeping(static_m, TILT) + noise_m,
            )
        )
    size = size_of(refitted(creep.EFFECT, view_of_recordings(recordings))[1])
    assert size.value == pytest.approx(1.0, rel=0.05)
    low, high = size.ci95
    assert low < 1.0 < high
    # Two standard errors of the creep law alone, which is known to 15 %.
    assert high - low >= 2 * 2.0 * 0.15 * size.value


def test_the_size_of_a_coupling_is_the_injected_coupling():
    """A free hysteresis absorbs two fifths of the coupling, but none of its stated size."""
    share, coupling = 0.005, cross_coupling.EFFECT
    stage = thinned([with_another_axis(recording(kind)) for kind in ("sweep", "walk")], EVERY)
    view = view_of_recordings([coupling.inject(r, share) for r in stage])
    size = size_of(refitted(coupling, view)[1])
    assert size.value == pytest.approx(100.0 * share, rel=0.05)
    assert size.ci95[0] < 100.0 * share < size.ci95[1]


@pytest.mark.parametrize(("amplitude_nm", "max_ratio"), [(180.0, 1.2), (400.0, 1.5)])
def test_the_size_of_a_periodic_error_is_its_amplitude_over_the_true_position(
    amplitude_nm, max_ratio
):
    """Over the reading, higher orders of the error of an eighth of its period remain.

    An error of 400 nm is steeper than the motion: one reading belongs to several positions.
    """
    period_nm = 1500.0
    ideals, recordings = [recording("sweep"), recording("waves")], []
    for ideal in ideals:
        displacement_m = ideal.displacement_m()
        error_m = 1e-9 * amplitude_nm * np.sin(2e9 * np.pi * displacement_m / period_nm + 1.0)
        recordings.append(with_displacement(ideal, displacement_m + error_m))
    view = view_of_recordings(thinned(recordings, EVERY))
    _, cause = refitted(sensor_periodic_error.EFFECT, view)
    assert cause.view.rms < max_ratio * view_of_recordings(thinned(ideals, EVERY)).rms
    size = size_of(cause)
    assert size.value == pytest.approx(amplitude_nm, rel=0.02)
    assert size.ci95[0] < amplitude_nm < size.ci95[1]


def test_a_periodic_error_repeats_along_the_motion_by_all_effects():
    """The coupling moves the stage by a third of a period, faster than readings are averaged."""
    ideals, recordings = [], []
    for kind in ("sweep", "waves"):
        alone = recording(kind)
        wave = np.sin(120.0 * np.pi * np.arange(alone.samples) / alone.sampling_rate_Hz)
        channel = Channel(quantity=Quantity.VOLTAGE, axis="y", values=30.0 * wave, label="y")
        ideals.append(replace(alone, channels=(*alone.channels, channel)))
        displacement_m = alone.displacement_m() + 300e-9 * wave
        error_m = 100e-9 * np.sin(2.0 * np.pi * displacement_m / 800e-9)
        recordings.append(with_displacement(ideals[-1], displacement_m + error_m))
    ideal_view, view = view_of_recordings(ideals), view_of_recordings(recordings)
    periods = 2.0 * view.half_stroke_m / 800e-9
    effects = [
        SelectedEffect(effect=cross_coupling.EFFECT, parameters={}),
        SelectedEffect(effect=sensor_periodic_error.EFFECT, parameters={"periods": periods}),
    ]
    ideal_rms_m = ideal_view.rms * ideal_view.half_stroke_m
    assert with_effects(view, effects).rms * view.half_stroke_m < 1.2 * ideal_rms_m
    assert with_effects(view, effects[:1]).rms * view.half_stroke_m > 2.0 * ideal_rms_m


def test_the_motion_is_the_response_of_the_model_without_zeros():
    """A delay and a coupling move the stage; without sensor errors it is read as it moves."""
    view = view_of_recordings([with_another_axis(recording(kind)) for kind in ("sweep", "waves")])
    effects = [
        SelectedEffect(effect=delay.EFFECT, parameters={"delay_s": 0.003}),
        SelectedEffect(effect=cross_coupling.EFFECT, parameters={}),
    ]
    with_both = with_effects(view, effects)
    for k, track in enumerate(with_both.tracks):
        residual = with_both.null.residual[with_both.track_rows(k)]
        zero = track.response[track.rows] - residual - with_both.motion[k][track.rows]
        assert np.ptp(zero) < 1e-6


def test_a_coupling_to_a_ramp_is_significant_though_a_ramp_backwards_explains_as_much():
    """Beside the ramp, which has play, the ramp backwards explains nothing."""
    coupled, uncoupled = [], []
    for k, kind in enumerate(("sweep", "walk", "waves")):
        alone = recording(kind)
        ramp_V = np.linspace(-30.0, 30.0, alone.samples)
        if k == 2:
            ramp_V = 30.0 * np.sin(np.linspace(0.0, 5.0 * np.pi, alone.samples))
        channel = Channel(quantity=Quantity.VOLTAGE, axis="y", values=ramp_V, label="y")
        uncoupled.append(replace(alone, channels=(*alone.channels, channel)))
        coupled.append(cross_coupling.EFFECT.inject(uncoupled[-1], 0.005))
    _, cause = refitted(cross_coupling.EFFECT, view_of_recordings(thinned(coupled, EVERY)))
    assert cause.placebo.cv.gain > 0.7 * cause.cv.gain
    assert cause.is_significant
    _, absent = refitted(cross_coupling.EFFECT, view_of_recordings(thinned(uncoupled, EVERY)))
    assert not absent.is_significant


def test_a_parameter_without_influence_does_not_change_the_interval_of_a_size():
    """With such a parameter the interval of a rate dependence was not finite."""
    _, test, cause = clipping_cause(2)
    selected = cause.selected
    parameters, free = {**selected.parameters, "idle": 1.0}, {**selected.free, "idle": 2.0}
    with_idle = replace(selected, parameters=parameters, free=free)
    expected = size_of(cause)
    size = size_of(evaluate(with_idle, cause.view, cause.without, test=test))
    assert size.value == expected.value
    assert size.ci95 == pytest.approx(expected.ci95, rel=1e-3)
