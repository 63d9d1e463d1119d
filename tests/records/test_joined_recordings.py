"""Two recordings in one file are reported; deliberate steps of a drive are not."""

import numpy as np
import pytest

from piezoid.identification.fit import unfitted_stage
from piezoid.records.checks.joined_recordings import JOINED
from piezoid.records.collection import collect
from piezoid.records.lab import Lab
from piezoid.statement import Statement
from tests.laws import LAWS, triangles, write

SWEEP, PART = triangles(4, 400), 0.6 * triangles(3, 250)[30:]
RESPONSE = LAWS["plays"]
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
    path = write(folder / "sweep.csv", field, 10.0 * RESPONSE(field))
    return [s for s in collect([path])[0].statements if s.quantity == JOINED]


def test_a_jump_between_two_sweeps_is_reported_with_size_time_and_ratio(tmp_path):
    field = np.concatenate([SWEEP[:-150], PART])
    steps_V = 5.0 * np.abs(np.diff(field))
    (statement,) = joined(tmp_path, field)
    assert statement.value == pytest.approx(steps_V[len(SWEEP) - 151], rel=1e-4)
    assert f"at {(len(SWEEP) - 150) / 500.0:.4g} s" in statement.text
    ratio = steps_V.max() / np.sort(steps_V)[-2]
    assert f"{ratio:.0f} times" in statement.text


def test_the_fit_repeats_the_report(tmp_path):
    field = np.concatenate([SWEEP[:-150], PART])
    path = write(tmp_path / "sweep.csv", field, 10.0 * RESPONSE(field))
    recordings = collect([path]).recordings
    (statement,) = (s for s in recordings[0].statements if s.quantity == JOINED)
    assert f"sweep.csv: {statement.text}" in unfitted_stage(recordings, Lab()).remarks


@pytest.mark.parametrize("field", DELIBERATE.values(), ids=DELIBERATE)
def test_deliberate_steps_are_not_reported(field, tmp_path):
    assert joined(tmp_path, field) == []
