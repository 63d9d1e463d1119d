"""Reported before a fit: too little of a drive, and two recordings in one file."""

import numpy as np
import pytest

from piezoid.identification.fit import fit, unfitted_stage
from piezoid.records.checks.joined_recordings import JOINED
from piezoid.records.collection import collect
from piezoid.records.drive_scope import scope_statements
from piezoid.records.lab import Lab
from piezoid.statement import Statement
from tests.laws import LAWS, recorded, triangles, write
from tests.records.tables import statements_of

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


SWEEP, PART = triangles(4, 400), 0.6 * triangles(3, 250)[30:]
REST = np.zeros(400)
LEVELS = np.random.default_rng(4).uniform(-1.0, 1.0, 20)
SINE = np.sin(np.linspace(0.0, 30.0, 2000))
SAWTOOTH = np.tile(np.linspace(-1.0, 1.0, 500), 2)
DELIBERATE = {
    "one sweep": SWEEP,
    "a sine": SINE,
    "a step from a rest": np.concatenate([REST, 0.8 + 0.1 * triangles(3, 300)]),
    "a step to a rest": np.concatenate([SWEEP[:-100], REST]),
    "a staircase": np.repeat(LEVELS, 100),
    "a staircase behind a sweep": np.concatenate([SWEEP, np.repeat(LEVELS, 100)]),
    "a sawtooth": SAWTOOTH,
    "a glitch": np.concatenate([SWEEP[:700], [0.9], SWEEP[700:]]),
    "noise": np.random.default_rng(5).normal(0.0, 0.3, 2000).clip(-1.0, 1.0),
}


def joined(folder, field) -> list[Statement]:
    return statements_of(recorded(folder, field, 10.0 * RESPONSE(field)), JOINED)


def test_a_jump_between_two_sweeps_is_reported_by_recording_and_fit(tmp_path):
    field = np.concatenate([SWEEP[:-150], PART])
    steps_V = 5.0 * np.abs(np.diff(field))
    recording = recorded(tmp_path, field, 10.0 * RESPONSE(field))
    (statement,) = statements_of(recording, JOINED)
    assert statement.value == pytest.approx(steps_V[len(SWEEP) - 151], rel=1e-4)
    assert f"at {(len(SWEEP) - 150) / 500.0:.4g} s" in statement.text
    ratio = steps_V.max() / np.sort(steps_V)[-2]
    assert f"{ratio:.0f} times" in statement.text
    assert f"sweep.csv: {statement.text}" in unfitted_stage([recording], Lab()).remarks


@pytest.mark.parametrize("field", DELIBERATE.values(), ids=DELIBERATE)
def test_deliberate_steps_are_not_reported(field, tmp_path):
    assert joined(tmp_path, field) == []
