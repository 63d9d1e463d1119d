"""`piezoid plan` on a folder: which axis it is about, what is written, what that was made from."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.identification.store import write_model
from piezoid_cli.main import app
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model

RATE = ("--rate", "1000")


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    folder = tmp_path / "stage"
    folder.mkdir()
    model = stage_model(axis_model("x"), axis_model("y"))
    other = replace(diagnosed(finding("lag", rivals=("delay",))), axis="y")
    (folder / "model.json").write_bytes(write_model(model))
    creep = diagnosed(finding("creep", rivals=("thermal_drift",)))
    (folder / "diagnosis.json").write_bytes(write_diagnosis(creep, further_axes=(other,)))
    return folder


@pytest.mark.parametrize(
    ("words", "axis", "effects"),
    [((), "x", {"creep", "thermal_drift"}), (("--axis", "y"), "y", {"lag", "delay"})],
)
def test_a_plan_is_about_the_axis_that_is_named_or_the_first(stage, words, axis, effects):
    done = CliRunner().invoke(app, ["plan", str(stage), *RATE, *words, "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads((stage / "plan.json").read_bytes())
    assert json.loads(done.stdout) == found
    assert found["axis"] == axis
    assert set(found["question"]["effects"]) == effects
    assert (stage / "drive.csv").exists()
    held = json.loads((stage / "diagnosis.json").read_bytes())["digest"]
    assert held in json.dumps(found)


def test_an_axis_that_was_not_diagnosed_is_a_wrong_use_and_nothing_is_written(stage):
    done = CliRunner().invoke(app, ["plan", str(stage), *RATE, "--axis", "w"])
    assert done.exit_code == 2
    assert not (stage / "plan.json").exists()


def test_what_the_plan_does_not_cover_is_said(stage):
    done = CliRunner().invoke(app, ["plan", str(stage), *RATE])
    shown = " ".join(done.output.split())
    assert "record a small chirp first" in shown
    assert "The recordings of the diagnosis were not given" in shown
