"""The engine of the diagnosis: what decides is the effect refitted, not its tangent."""

from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.candidate import is_consistent
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import delay, lag, slew_limit
from piezoid.diagnosis.initial_state_search import (
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.refinement import initial_guess, refine, refine_together
from piezoid.diagnosis.refitted_view import SETTLED, SelectedEffect, with_effects
from piezoid.diagnosis.residual_view import View, with_cycled_drives
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.signals import with_displacement
from piezoid.operators.filters import later
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import causes, healthy, recorded, view_of_recordings

LATE_s = 3e-4


@cache
def late_view() -> View:
    recordings, lab = healthy()
    late = [
        with_displacement(r, later(r.displacement_m(), LATE_s * r.sampling_rate_Hz))
        for r in recordings
    ]
    return view_of_recordings(tuple(late), lab)


def test_the_memory_of_cycled_drives_is_left_alone_and_another_one_is_found():
    known, lab = recorded(draw_campaign(404, truth="preisach", plans=("sweep", "check")))
    view = view_of_recordings(known, lab)
    assert (
        with_individual_initial_states(view, with_shared_initial_state(view)).rms > 0.95 * view.rms
    )
    unknown, lab = recorded(
        draw_campaign(407, truth="preisach", plans=("sweep", "check"), careless=True)
    )
    view = view_of_recordings(unknown, lab)
    found = with_individual_initial_states(view, with_shared_initial_state(view))
    assert found.rms < 0.9 * view.rms
    assert with_cycled_drives(found).rms == pytest.approx(view.rms)


def test_errors_of_coefficients_know_that_rows_of_a_block_are_not_independent():
    chance = np.random.default_rng(2)
    block = np.repeat(np.arange(40), 50)
    column = np.repeat(chance.normal(size=40), 50)[:, None]
    found, said = [], []
    for _ in range(200):
        error = np.repeat(chance.normal(size=40), 50) + 0.1 * chance.normal(size=2000)
        null = Null(columns=np.ones((2000, 1)), response=error, block=block)
        across = null.project_out(column)[:, 0]
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


def test_a_limit_and_the_lag_behind_it_are_found_together_and_not_one_after_the_other():
    sizes = {"slew_limit": 0.5, "lag": 0.3}
    campaign = draw_campaign(12, truth="preisach", plans=("sweep", "rates"), effects=sizes)
    numbers = {effect.name: effect.numbers for effect in campaign.answer.effects}
    clean = view_of_recordings(*recorded(campaign))
    found, view = [], clean
    for effect in (slew_limit.EFFECT, lag.EFFECT):
        seen = score_test(effect, view)
        one = initial_guess(effect, seen.trial, float(seen.cv.coefficient[0]))
        better, view = refine(one, clean, found)
        found.append(better)
    together, left = refine_together(found, clean, [])
    true_s = float(numbers["lag"]["time_constant_s"])
    apart_s, found_s = (pair[1].parameters["time_s"] for pair in (found, together))
    assert abs(found_s / true_s - 1.0) < 0.5 * abs(apart_s / true_s - 1.0)
    assert left.rms < 0.8 * view.rms
    assert left.rms == pytest.approx(with_effects(clean, together).rms, rel=SETTLED)


DRIFT_m = 1e-8  # at the end, of 46 um


@pytest.mark.slow
@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_drift_beside_a_single_sweep_is_bounded_as_it_is_and_not_as_it_shows():
    (recording,), lab = recorded(draw_campaign(21, truth="preisach", plans=("sweep",)))
    slow_m = DRIFT_m * np.linspace(-1.0, 1.0, recording.samples)
    drifting = with_displacement(recording, recording.displacement_m() + slow_m)
    diagnosis = diagnose([drifting], lab=lab)
    assert causes(diagnosis) == ()
    (drift,) = (absent for absent in diagnosis.not_detected if absent.effect == "thermal_drift")
    assert drift.upper_bound_m is not None
    assert float(np.std(slow_m)) < drift.upper_bound_m < 3.0 * float(np.std(slow_m))
