"""Refinement of effects: a decision rests on the refitted effect and not on its tangent."""

from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.candidate import is_consistent
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.effects import delay, lag, slew_limit
from piezoid.diagnosis.nuisance_search import (
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.refinement import (
    SETTLED,
    SelectedEffect,
    initial_guess,
    refine,
    with_effects,
)
from piezoid.diagnosis.residual_view import View, with_cycled_drives
from piezoid.diagnosis.score_test import score_test
from piezoid.diagnosis.signals import with_displacement
from piezoid.operators.filters import later
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import causes, healthy, read_campaign, view_of_recordings

DELAY_s = 3e-4


@cache
def delayed_view() -> View:
    recordings, lab = healthy()
    delayed = [
        with_displacement(r, later(r.displacement_m(), DELAY_s * r.sampling_rate_Hz))
        for r in recordings
    ]
    return view_of_recordings(tuple(delayed), lab)


def test_an_initial_state_is_fitted_to_careless_recordings_but_not_to_cycled_ones():
    cycled, lab = read_campaign(draw_campaign(404, truth="preisach", plans=("sweep", "check")))
    view = view_of_recordings(cycled, lab)
    assert (
        with_individual_initial_states(view, with_shared_initial_state(view)).rms > 0.95 * view.rms
    )
    careless, lab = read_campaign(
        draw_campaign(407, truth="preisach", plans=("sweep", "check"), careless=True)
    )
    view = view_of_recordings(careless, lab)
    individual = with_individual_initial_states(view, with_shared_initial_state(view))
    assert individual.rms < 0.9 * view.rms
    assert with_cycled_drives(individual).rms == pytest.approx(view.rms)


def test_errors_of_coefficients_account_for_dependent_rows_of_a_block():
    rng = np.random.default_rng(2)
    block = np.repeat(np.arange(40), 50)
    column = np.repeat(rng.normal(size=40), 50)[:, None]
    estimates, stated_errors = [], []
    for _ in range(200):
        error = np.repeat(rng.normal(size=40), 50) + 0.1 * rng.normal(size=2000)
        null = Null(columns=np.ones((2000, 1)), response=error, block=block)
        across = null.project_out(column)[:, 0]
        estimates.append(float(across @ error / (across @ across)))
        stated_errors.append(float(null.clustered_covariance(column)[0, 0]) ** 0.5)
    # Independent rows would give a seventh of it.
    assert np.mean(stated_errors) == pytest.approx(np.std(estimates), rel=0.2)


@pytest.mark.parametrize("duration", [None, 60], ids=["permanent", "temporary"])
def test_powers_of_steps_are_those_of_a_regression_with_each_step(duration):
    rng = np.random.default_rng(3)
    null = Null(
        columns=rng.normal(size=(300, 4)),
        response=rng.normal(size=300),
        block=np.repeat(np.arange(10), 30),
        extra=rng.normal(size=(300, 1)),
    )
    rows, values = slice(50, 250), rng.normal(size=200)
    powers = null.step_powers(values, rows, duration)
    for first in (0, 77, 170):
        step = np.zeros((300, 2))
        stop = 250 if duration is None else min(50 + first + duration, 250)
        step[50 + first : stop] = np.column_stack([values, np.ones(200)])[first : stop - 50]
        design = np.hstack([null.all_columns, step])
        _, (square,), *_ = np.linalg.lstsq(design, null.response, rcond=None)
        assert powers[first] == pytest.approx(null.residual @ null.residual - square)


def test_a_delay_in_one_recording_is_not_a_delay_of_the_stage():
    recordings, lab = healthy()
    delayed_rates = [
        with_displacement(r, later(r.displacement_m(), 4e-4 * r.sampling_rate_Hz))
        if "rates" in r.name
        else r
        for r in recordings
    ]
    view = view_of_recordings(tuple(delayed_rates), lab)
    test = score_test(delay.EFFECT, view)
    (selected,), refitted = refine([initial_guess(delay.EFFECT, test.trial, 1.0)], view)
    assert not is_consistent(selected, refitted)
    start = SelectedEffect(
        effect=delay.EFFECT, parameters={"delay_s": DELAY_s}, free={"delay_s": 1.5}
    )
    (selected,), refitted = refine([start], delayed_view())
    assert is_consistent(selected, refitted)


def test_a_slew_limit_and_a_lag_are_refined_together():
    sizes = {"slew_limit": 0.5, "lag": 0.3}
    campaign = draw_campaign(12, truth="preisach", plans=("sweep", "rates"), effects=sizes)
    numbers = {effect.name: effect.numbers for effect in campaign.answer.effects}
    clean = view_of_recordings(*read_campaign(campaign))
    selected, view = [], clean
    for effect in (slew_limit.EFFECT, lag.EFFECT):
        test = score_test(effect, view)
        guess = initial_guess(effect, test.trial, float(test.cv.coefficient[0]))
        (refined,), view = refine([guess], clean, selected)
        selected.append(refined)
    joint, joint_view = refine(selected, clean)
    expected_s = float(numbers["lag"]["time_constant_s"])
    sequential_s, joint_s = (pair[1].parameters["time_s"] for pair in (selected, joint))
    assert abs(joint_s / expected_s - 1.0) < 0.5 * abs(sequential_s / expected_s - 1.0)
    assert joint_view.rms < 0.8 * view.rms
    assert joint_view.rms == pytest.approx(with_effects(clean, joint).rms, rel=SETTLED)


DRIFT_m = 1e-8  # at the end; the stroke is 46 um


@pytest.mark.slow
@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_the_bound_on_a_drift_covers_what_a_single_sweep_hides():
    (recording,), lab = read_campaign(draw_campaign(21, truth="preisach", plans=("sweep",)))
    drift_m = DRIFT_m * np.linspace(-1.0, 1.0, recording.samples)
    drifting = with_displacement(recording, recording.displacement_m() + drift_m)
    diagnosis = diagnose([drifting], lab=lab)
    assert causes(diagnosis) == ()
    (drift,) = (absent for absent in diagnosis.not_detected if absent.effect == "thermal_drift")
    assert drift.upper_bound_m is not None
    assert float(np.std(drift_m)) < drift.upper_bound_m < 3.0 * float(np.std(drift_m))
