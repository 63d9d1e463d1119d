"""The engine of the diagnosis: what decides is the effect refitted, not its tangent."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import Null, paired_z
from piezoid.diagnosis.bouc_wen_search import with_best_bouc_wen
from piezoid.diagnosis.candidate import evaluate, is_consistent
from piezoid.diagnosis.effects import delay, lag, non_congruence, thermal_drift
from piezoid.diagnosis.initial_state_search import (
    with_own_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.nuisance_columns import PLAYS, REACH, SHARED, shape, shape_columns
from piezoid.diagnosis.refinement import initial_guess, refine
from piezoid.diagnosis.refitted_view import SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View, cycled
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.signals import with_displacement
from piezoid.operators.bouc_wen import bouc_wen_states
from piezoid.operators.filters import later
from piezoid.records.recording import Quantity
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import healthy, healthy_view, recorded, view_of_recordings

LATE_s = 3e-4


@cache
def late_view() -> View:
    recordings, lab = healthy()
    late = [
        with_displacement(r, later(r.displacement_m(), LATE_s * r.sampling_rate_Hz))
        for r in recordings
    ]
    return view_of_recordings(tuple(late), lab)


def test_the_response_without_columns_is_the_response_with_them():
    chance = np.random.default_rng(1)
    states, rubs = chance.normal(size=(50, PLAYS)), chance.normal(size=(50, len(REACH)))
    drive, weight = chance.normal(size=50), chance.normal(size=SHARED)
    expected = shape_columns(states, rubs, drive) @ weight
    np.testing.assert_allclose(shape(states, rubs, drive, weight), expected, rtol=1e-10, atol=1e-9)


def test_a_delay_is_found_though_its_tangent_was_at_another_time():
    seen = score_test(delay.EFFECT, late_view())
    one, view = refine(
        initial_guess(delay.EFFECT, seen.trial, float(seen.cv.coefficient[0])), late_view(), []
    )
    assert seen.trial.parameters["delay_s"] != pytest.approx(LATE_s, rel=0.1)
    assert one.parameters["delay_s"] == pytest.approx(LATE_s, rel=0.02)
    assert view.rms < 0.5 * late_view().rms


def test_a_delay_leaves_less_than_a_lag_where_the_reading_was_late():
    errors = {}
    for effect, name in ((delay.EFFECT, "delay_s"), (lag.EFFECT, "time_s")):
        start = SelectedEffect(effect=effect, parameters={name: LATE_s}, free={name: 1.5})
        _, view = refine(start, late_view(), [], finer=2)
        errors[name] = view
    assert errors["delay_s"].rms < 0.8 * errors["time_s"].rms
    assert paired_z(errors["time_s"].null.energy, errors["delay_s"].null.energy) > 2.0


def test_nothing_accepted_changes_nothing():
    view = late_view()
    assert with_effects(view, []) is view


def test_the_memory_of_cycled_drives_is_left_alone_and_another_one_is_found():
    known, lab = recorded(draw_campaign(404, truth="preisach", plans=("sweep", "check")))
    view = view_of_recordings(known, lab)
    assert with_own_initial_states(view, with_shared_initial_state(view)).rms > 0.95 * view.rms
    unknown, lab = recorded(
        draw_campaign(407, truth="preisach", plans=("sweep", "check"), careless=True)
    )
    view = view_of_recordings(unknown, lab)
    found = with_own_initial_states(view, with_shared_initial_state(view))
    assert found.rms < 0.9 * view.rms
    assert cycled(found).rms == pytest.approx(view.rms)


def test_an_effect_of_which_nothing_is_left_once_all_is_refitted_is_none():
    view = healthy_view()
    seen = score_test(thermal_drift.EFFECT, view)
    gone = replace(thermal_drift.EFFECT, columns=lambda v, _: np.zeros((len(v.response), 0)))
    one = evaluate(SelectedEffect(effect=gone, parameters={}), view, view, test=seen)
    assert not one.is_significant
    assert one.share == 0.0


def test_an_opening_below_the_least_one_is_below_its_limit():
    found = score_test(non_congruence.EFFECT, healthy_view())
    opening = abs(float(found.cv.coefficient[0]))
    np.testing.assert_allclose(found.floor, found.share * non_congruence.OPENING / opening)


def test_one_bouc_wen_state_follows_a_bouc_wen_ceramic_to_its_noise():
    campaign = draw_campaign(305, truth="bouc_wen", plans=("sweep", "check", "chirp"))
    recordings, lab = recorded(campaign)
    view = view_of_recordings(recordings, lab)
    noise = campaign.answer.noise_rms_m / view.half_stroke_m
    assert view.rms > 2.0 * noise
    assert with_best_bouc_wen(view).rms < 1.4 * noise


def test_errors_of_coefficients_know_that_rows_of_a_block_are_not_independent():
    chance = np.random.default_rng(2)
    block = np.repeat(np.arange(40), 50)
    column = np.repeat(chance.normal(size=40), 50)[:, None]
    found, said = [], []
    for _ in range(200):
        error = np.repeat(chance.normal(size=40), 50) + 0.1 * chance.normal(size=2000)
        null = Null(columns=np.ones((2000, 1)), response=error, block=block)
        across = null.without(column)[:, 0]
        found.append(float(across @ error / (across @ across)))
        said.append(float(null.clustered_covariance(column)[0, 0]) ** 0.5)
    # rows counted one by one would say a seventh of it
    assert np.mean(said) == pytest.approx(np.std(found), rel=0.2)


def test_a_reading_that_is_late_in_one_recording_is_no_delay_of_the_stage():
    recordings, lab = healthy()
    one_late = [
        with_displacement(r, later(r.displacement_m(), 4e-4 * r.sampling_rate_Hz))
        if "rates" in r.name
        else r
        for r in recordings
    ]
    view = view_of_recordings(tuple(one_late), lab)
    seen = score_test(delay.EFFECT, view)
    found, there = refine(initial_guess(delay.EFFECT, seen.trial, 1.0), view, [])
    assert not is_consistent(found, there)
    start = SelectedEffect(
        effect=delay.EFFECT, parameters={"delay_s": LATE_s}, free={"delay_s": 1.5}
    )
    assert is_consistent(*refine(start, late_view(), []))


def test_one_frequency_does_not_tell_a_lag_from_a_width_of_the_loop():
    recordings, lab = healthy()
    whole = next(r for r in recordings if "sweep" in r.name)
    turn = 2.0 * np.pi * np.arange(whole.samples) / 500.0
    drive = np.sin(turn)
    moved_m = 1e-5 * (drive - 0.2 * bouc_wen_states(drive, 2.0, 0.5, 1.2))
    noise_m = 3e-9 * np.random.default_rng(3).normal(size=whole.samples)
    channels = tuple(
        replace(c, values=moved_m + noise_m)
        if c.quantity is Quantity.DISPLACEMENT
        else replace(c, values=5.0 + 5.0 * drive)
        for c in whole.channels
    )
    view = view_of_recordings((replace(whole, channels=channels),), lab)
    for effect in (delay.EFFECT, lag.EFFECT):
        seen = score_test(effect, view)
        assert not seen.separable
        assert not seen.physical
    assert score_test(delay.EFFECT, late_view()).separable
