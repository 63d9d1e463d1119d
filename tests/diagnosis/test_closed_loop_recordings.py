"""Closed-loop recordings at a constant sensor: the drive shows creep, drift, or neither."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from tests.diagnosis.bench import finding_of
from tests.laws import LAWS, RATE_Hz, write

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")

MOVE, HOLD = 600, 6000
SHARE = 0.015  # of the step, each decade
HOLD_s = np.arange(HOLD) / RATE_Hz


def constant_sensor(disturbance: Array) -> tuple[Array, Array]:
    """Return drive and reading of an approach, a hold under feedback, and a retraction.

    disturbance  (HOLD,)  motion that the feedback compensates, in units of the field
    """
    approach = np.linspace(1.0, -0.8, MOVE)
    return_path = np.linspace(0.0, 1.0, MOVE)
    correction = np.zeros(HOLD)
    for _ in range(60):  # integrator of the loop
        position = LAWS["preisach"](np.concatenate([approach, approach[-1] + correction]))
        correction = correction - (position[MOVE:] - position[MOVE - 1] + disturbance)
    field = np.concatenate([approach, approach[-1] + correction])
    retract = field[-1] + return_path * (1.0 - field[-1])
    field = np.concatenate([field, retract])
    disturbance_path = np.concatenate(
        [np.zeros(MOVE), disturbance, np.full(MOVE, disturbance[-1])]
    )
    noise = 2e-4 * np.random.default_rng(3).standard_normal(len(field))
    return field, 10.0 * (LAWS["preisach"](field) + disturbance_path) + noise


def diagnosed(folder: Path, disturbance: Array) -> Diagnosis:
    field, reading_um = constant_sensor(disturbance)
    cuts = {"a": slice(0, MOVE), "b": slice(MOVE, MOVE + HOLD), "c": slice(MOVE + HOLD, None)}
    files = [
        write(folder / f"{name}.csv", field[part], reading_um[part]) for name, part in cuts.items()
    ]
    return diagnose([collect([path])[0] for path in files], axis="x")


def test_creep_at_a_constant_sensor_is_named_with_its_size(tmp_path):
    step = 1.8
    creep = -SHARE * step * np.log10(1.0 + HOLD_s / 0.02) * 0.5
    diagnosis = diagnosed(tmp_path, creep)
    finding = finding_of(diagnosis, "creep")
    low, high = finding.size.ci95
    approach = LAWS["preisach"](np.linspace(1.0, -0.8, MOVE))
    assert low < 100 * SHARE * step * 0.5 / abs(approach[-1] - approach[0]) < high
    assert "b.csv a feedback holds the sensor" in finding.explanation


def test_a_linear_change_of_a_constant_sensor_is_not_creep(tmp_path):
    diagnosis = diagnosed(tmp_path, -0.05 * HOLD_s / HOLD_s[-1])
    assert "creep" not in diagnosis.names


def test_a_change_against_the_previous_move_is_not_creep(tmp_path):
    reverse = 0.02 * np.log10(1.0 + HOLD_s / 0.02)
    assert "creep" not in diagnosed(tmp_path, reverse).names
