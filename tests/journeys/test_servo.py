"""`piezoid fit` on a stage behind a servo reports a lag, and not hysteresis."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piezoid.identification.fit import rig_of
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid_datasets.virtual_lab.stage import Stage
from piezoid_datasets.virtual_lab.truths.return_point import draw_preisach
from piezoid_datasets.virtual_lab.write import csv_text, lab_toml
from tests.journeys.command import run
from tests.plays_alone import fit_one_order, fit_plays_alone
from tests.servo import servo_stage, triangles

BANDWIDTH_Hz = 10.0
LAG_s = 1.0 / (2.0 * np.pi * BANDWIDTH_Hz)


def write(folder: Path, stage: Stage) -> None:
    """Record triangles of 1 Hz and write them with lab.toml."""
    (folder / "triangles.csv").write_text(csv_text(triangles(stage, (1.0,)), axis="x"))
    (folder / "lab.toml").write_text(lab_toml(stage.rig))


@pytest.fixture(scope="module")
def servo(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, str, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("servo")
    write(folder, servo_stage(BANDWIDTH_Hz, seed=3))
    arguments = (folder / "triangles.csv", "--lab", folder / "lab.toml", "--out", folder / "out")
    with pytest.MonkeyPatch.context() as patch:
        fit_plays_alone(patch)
        fit_one_order(patch)
        status, output = run("fit", *arguments)
    model: dict[str, Any] = json.loads((folder / "out" / "model.json").read_bytes())
    return status, output, model["axes"]["x"]


def test_a_wide_loop_caused_by_a_lag_is_reported_as_lag(servo):
    status, output, axis = servo
    assert status == 1
    assert axis["verdict"]["applies"] is False
    assert "is phase lag, not hysteresis" in axis["verdict"]["reason"]
    assert "a lag of 15.9 ms" in axis["verdict"]["reason"]
    assert "is phase lag, not hysteresis" in output


def test_the_lag_has_the_time_constant_of_the_servo(servo):
    """Plays that are fitted together with the lag absorb part of it."""
    assert servo[2]["lag"]["time_s"] == pytest.approx(LAG_s, rel=0.1)


def test_a_ceramic_behind_a_lag_is_not_reported_as_lag(tmp_path):
    write(
        tmp_path,
        servo_stage(BANDWIDTH_Hz, seed=3, ceramic=draw_preisach(np.random.default_rng(5))),
    )
    lab = read_lab(tmp_path / "lab.toml")
    recording = collect([tmp_path / "triangles.csv"], lab)[0]
    axis = estimate_axis([recording], "x", rig_of(lab, "x"), orders=((8, 2),))
    assert axis.verdict.applies
