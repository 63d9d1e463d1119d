"""`piezoid plan` on a stage: its axis, its files, and its sources."""

import json
from dataclasses import replace
from math import sin
from pathlib import Path

import pytest
from typer.testing import CliRunner

from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.digests import digest_of_file
from piezoid.formatting import with_unit
from piezoid.identification.store import write_model
from piezoid_cli.main import app
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model, starts

RATE = ("--rate", "1000")


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    folder = tmp_path / "stage"
    folder.mkdir()
    model = stage_model(axis_model("x"), axis_model("y"))
    lag = replace(diagnosed(finding("lag", rivals=("delay",))), axis="y")
    (folder / "model.json").write_bytes(write_model(model))
    creep = diagnosed(finding("creep", rivals=("thermal_drift",)))
    (folder / "diagnosis.json").write_bytes(write_diagnosis(creep, further_axes=(lag,)))
    return folder


@pytest.mark.parametrize(
    ("words", "axis", "effects"),
    [((), "x", {"creep", "thermal_drift"}), (("--axis", "y"), "y", {"lag", "delay"})],
)
def test_a_plan_is_for_the_named_axis_or_the_first(stage, words, axis, effects):
    result = CliRunner().invoke(app, ["plan", str(stage), *RATE, *words, "--json"])
    assert result.exit_code == 0, result.output
    plan = json.loads((stage / "plan.json").read_bytes())
    assert json.loads(result.stdout) == plan
    assert plan["axis"] == axis
    assert set(plan["question"]["effects"]) == effects
    assert (stage / "drive.csv").exists()
    digest = json.loads((stage / "diagnosis.json").read_bytes())["digest"]
    assert digest in json.dumps(plan)


def test_an_axis_without_diagnosis_is_a_usage_error_and_nothing_is_written(stage):
    result = CliRunner().invoke(app, ["plan", str(stage), *RATE, "--axis", "w"])
    assert result.exit_code == 2
    assert not (stage / "plan.json").exists()


def test_recordings_of_the_fit_that_are_missing_are_named(stage, tmp_path):
    sweep = tmp_path / "sweep.csv"
    rows = [f"{k / 1000:.3f},{5 + 5 * sin(k / 300):.4f},{sin(k / 300):.4f}" for k in range(4000)]
    sweep.write_text("\n".join(("time [s],voltage [V],position [um]", *rows)) + "\n")
    of_axis_y = replace(axis_model("y"), starts=starts("other.csv"))
    model = replace(
        stage_model(axis_model("x"), of_axis_y),
        sources={
            "sweep.csv": digest_of_file(sweep),
            "chirp.csv": "sha256:1",
            "other.csv": "sha256:2",
        },
    )
    (stage / "model.json").write_bytes(write_model(model))
    result = CliRunner().invoke(app, ["plan", str(stage), str(sweep), *RATE])
    assert result.exit_code == 0, result.output
    output = " ".join(result.output.split())
    assert "1 of 2 recordings of the fit is missing: chirp.csv" in output
    sweep.write_text(sweep.read_text().replace("0.0000", "0.0001", 1))
    result = CliRunner().invoke(app, ["plan", str(stage), str(sweep), *RATE, "--force"])
    output = " ".join(result.output.split())
    assert "2 of 2 recordings of the fit are missing: sweep.csv, chirp.csv" in output


def test_drives_for_an_undetected_effect_are_compared_by_their_detection_limits(stage):
    """The chosen drive has the limit that the sentence and plan.json state."""
    diagnosis = diagnosed()
    limits = {"thermal_drift": 1e-6}
    not_detected = tuple(
        replace(absent, detection_limit_m=limits.get(absent.effect, 1e-12), upper_bound_m=1e-12)
        for absent in diagnosis.not_detected
    )
    content = write_diagnosis(replace(diagnosis, not_detected=not_detected))
    (stage / "diagnosis.json").write_bytes(content)
    result = CliRunner().invoke(app, ["plan", str(stage), *RATE], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    plan = json.loads((stage / "plan.json").read_bytes())
    assert plan["question"]["effects"] == ["thermal_drift"]
    assert "so far detected from 1.00 µm rms" in result.output
    expected = with_unit(plan["size"]["expected_detection_limit"], "m", 2)
    (row,) = (line for line in result.output.splitlines() if f"│ {plan['drive']['name']} " in line)
    assert row.rstrip(" │").endswith(expected)
    assert f"Expected detection limit: {expected} rms" in result.output


def test_gaps_of_a_plan_are_stated(stage):
    result = CliRunner().invoke(app, ["plan", str(stage), *RATE])
    output = " ".join(result.output.split())
    assert "record a small chirp first" in output
    assert "The recordings of the diagnosis were not given" in output
