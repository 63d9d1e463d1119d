"""Recordings that are too little for a fit of hysteresis are reported before the fit."""

import numpy as np
import pytest

from piezoid.identification.fit import fit
from piezoid.records.collection import collect
from piezoid.records.drive_scope import scope_statements
from tests.laws import LAWS, triangles, write

RESPONSE = LAWS["plays"]
TOO_LITTLE = {
    "branch": np.linspace(-1.0, 1.0, 300),
    "loop": triangles(1, 60)[:58],
}
RAMP = np.linspace(-1.0, 0.0, 200)
PHASE = np.linspace(0.0, 1.0, 2000)
OTHER_EXPERIMENTS = {
    "a chirp": 0.05 * np.sin(400.0 * PHASE**2),
    "a chirp behind a ramp": np.concatenate([RAMP, 0.05 * np.sin(400.0 * PHASE**2)]),
    "a step": np.repeat([-1.0, 1.0], 300),
    "a hold": np.concatenate([RAMP, np.zeros(800)]),
    "a staircase": np.repeat(np.r_[np.linspace(-1.0, 1.0, 12), np.linspace(1.0, -1.0, 12)], 50),
    "noise": np.random.default_rng(5).normal(0.0, 0.3, 2000).clip(-1.0, 1.0),
}


def recordings(folder, *fields):
    paths = [
        write(folder / f"{k}.csv", field, 10.0 * RESPONSE(field)) for k, field in enumerate(fields)
    ]
    return collect(paths).recordings


@pytest.mark.parametrize("lack", TOO_LITTLE)
def test_a_single_branch_and_a_single_loop_are_reported_as_the_fit_does(lack, tmp_path):
    recorded = recordings(tmp_path, TOO_LITTLE[lack])
    assert [s.quantity for s in scope_statements(recorded)] == [lack]
    limits = {limit.lack for limit in fit(recorded)["x"].quality.limits}
    assert limits & set(TOO_LITTLE) == {lack}


def test_two_loops_or_two_recordings_are_enough(tmp_path):
    assert scope_statements(recordings(tmp_path, triangles(2, 200))) == []
    assert scope_statements(recordings(tmp_path, triangles(1, 200), triangles(1, 300))) == []


@pytest.mark.parametrize("field", OTHER_EXPERIMENTS.values(), ids=OTHER_EXPERIMENTS)
def test_experiments_other_than_sweeps_are_not_reported(field, tmp_path):
    assert scope_statements(recordings(tmp_path, field)) == []
