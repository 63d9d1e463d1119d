"""A sensor that a feedback holds: the drive's answer is creep, drift, or neither."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from tests.laws import LAWS, RATE_Hz, write

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")

MOVE, HOLD = 600, 6000
SHARE = 0.015  # of the step, each decade
HOLD_s = np.arange(HOLD) / RATE_Hz


def held(law: str, moved: Array, *, seed: int = 3) -> tuple[Array, Array]:
    """Return field and reading of an approach, a hold against a motion, and a retraction.

    moved  (HOLD,)  what the stage does by itself, of the field's unit
    """
    approach = np.linspace(1.0, -0.8, MOVE)
    back = np.linspace(0.0, 1.0, MOVE)
    give = np.zeros(HOLD)
    for _ in range(60):  # the integrator of the loop
        position = LAWS[law](np.concatenate([approach, approach[-1] + give]))
        give = give - (position[MOVE:] - position[MOVE - 1] + moved)
    field = np.concatenate([approach, approach[-1] + give])
    retract = field[-1] + back * (1.0 - field[-1])
    field = np.concatenate([field, retract])
    aside = np.concatenate([np.zeros(MOVE), moved, np.full(MOVE, moved[-1])])
    noise = 2e-4 * np.random.default_rng(seed).standard_normal(len(field))
    return field, 10.0 * (LAWS[law](field) + aside) + noise


def diagnosed(folder: Path, law: str, moved: Array) -> Diagnosis:
    field, reading_um = held(law, moved)
    cuts = {"a": slice(0, MOVE), "b": slice(MOVE, MOVE + HOLD), "c": slice(MOVE + HOLD, None)}
    files = [
        write(folder / f"{name}.csv", field[part], reading_um[part]) for name, part in cuts.items()
    ]
    return diagnose([collect([path])[0] for path in files], axis="x")


@pytest.mark.parametrize("law", ["dahl", "preisach"])
def test_creep_in_a_hold_is_named_with_its_size(tmp_path, law):
    step = 1.8
    crept = -SHARE * step * np.log10(1.0 + HOLD_s / 0.02) * 0.5
    found = diagnosed(tmp_path, law, crept)
    finding = next(one for one in found.findings if one.effect == "creep")
    low, high = finding.size.ci95
    approach = LAWS[law](np.linspace(1.0, -0.8, MOVE))
    assert low < 100 * SHARE * step * 0.5 / abs(approach[-1] - approach[0]) < high
    assert "b.csv a feedback holds the sensor" in finding.explanation


def test_what_goes_on_evenly_in_a_hold_is_no_creep(tmp_path):
    found = diagnosed(tmp_path, "preisach", -0.05 * HOLD_s / HOLD_s[-1])
    assert "creep" not in found.names


def test_what_goes_against_the_move_before_is_no_creep(tmp_path):
    back = 0.02 * np.log10(1.0 + HOLD_s / 0.02)
    assert "creep" not in diagnosed(tmp_path, "preisach", back).names
