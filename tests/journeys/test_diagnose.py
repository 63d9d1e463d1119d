"""Recordings of today against the model of last month, and a diagnosis that stumbles."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from piezoid.diagnosis import effects
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid.identification.store import read_model, write_model
from piezoid_cli.main import app
from tests.plays_alone import fit_one_order, fit_plays_alone
from tests.reports.anatomy import Anatomy
from tests.reports.known_stage import axis_model, stage_model

STEP_um = {"x": 0.5, "y": 0.25}
COLUMNS = 'columns = { time = "time [s]", voltage = "voltage [V]", displacement = "pos [um]" }'


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four loops of each of two axes, read by sensors with coarse steps, and an older model."""
    folder = tmp_path_factory.mktemp("sweeps")
    k = np.arange(240)
    drive_V = 5.0 * (1.0 - np.cos(2.0 * np.pi * k / 60.0))
    late_V = np.concatenate([np.repeat(drive_V[:1], 3), drive_V[:-3]])
    lines = ['[rig]\nname = "two axes"']
    for axis, step_um in STEP_um.items():
        noise_um = 0.005 * np.random.default_rng(1).standard_normal(len(k))
        moved_um = 4.0 * step_um * (drive_V + 0.05 * late_V) + noise_um
        read_um = np.round(moved_um / step_um) * step_um
        rows = zip(k / 100.0, drive_V, read_um, strict=True)
        text = "".join(f"{t},{u:.5f},{y:.5f}\n" for t, u, y in rows)
        (folder / f"{axis}.csv").write_text(f"time [s],voltage [V],pos [um]\n{text}")
        lines.append(f'[[recording]]\nfile = "{axis}.csv"\naxis = "{axis}"\n{COLUMNS}')
    (folder / "lab.toml").write_text("\n".join(lines) + "\n")
    (folder / "model.json").write_bytes(write_model(stage_model(axis_model())))
    return folder


def ran(verb: str, folder: Path, *files: str, out: str) -> Result:
    given = [file if file[0] == "-" else str(folder / file) for file in files]
    rest = ["--lab", str(folder / "lab.toml"), "--out", str(folder / out)]
    with pytest.MonkeyPatch.context() as patch:
        fit_plays_alone(patch)
        fit_one_order(patch)
        return CliRunner(env={"COLUMNS": "200"}).invoke(app, [verb, *given, *rest])


@pytest.fixture(scope="module")
def today(sweeps: Path) -> Result:
    """What is said of axis x, with a model of last month in front."""
    return ran("diagnose", sweeps, "model.json", "x.csv", out="today")


@pytest.fixture(scope="module")
def plain(sweeps: Path) -> Result:
    """What is said of both axes' recordings, without any model."""
    return ran("diagnose", sweeps, "x.csv", "y.csv", out="plain")


def test_a_model_in_front_of_the_recordings_says_what_changed(sweeps: Path, today: Result) -> None:
    assert today.exit_code == 0, today.output
    content = (sweeps / "today/diagnosis.json").read_bytes()
    since = json.loads(content)["since_model"]
    assert since["model_digest"] == json.loads((sweeps / "model.json").read_text())["digest"]
    assert since["refitted_rms_m"] <= since["as_it_was_rms_m"]
    assert " ".join(since["explanation"].split()) in " ".join(today.output.split())
    (diagnosis,) = read_diagnoses(content)
    assert set(diagnosis.names) <= {"quantisation", "loop_shape"}
    assert "quantisation" in diagnosis.names


def test_without_a_model_the_axis_is_fitted_and_its_budget_adds_up(
    sweeps: Path, plain: Result
) -> None:
    assert plain.exit_code == 0, plain.output
    (diagnosis,) = read_diagnoses((sweeps / "plain/diagnosis.json").read_bytes())
    finding = next(one for one in diagnosis.findings if one.effect == "quantisation")
    assert finding.size.value == pytest.approx(1e3 * STEP_um["x"])
    power_m2 = sum(part.rms_m**2 for part in diagnosis.budget)
    assert power_m2 == pytest.approx(diagnosis.baseline.rms_m**2)
    page = Anatomy((sweeps / "plain/diagnosis.html").read_text())
    assert len(page.all("figure", "chart")) == 1
    assert not page.all("p", "alarm")


def test_recordings_that_tell_nothing_of_the_axis_are_named(today: Result, plain: Result) -> None:
    said = " ".join(plain.output.split())
    assert "not used: y.csv (axis x does not move or was not recorded" in said
    assert "not used" not in today.output


def test_a_model_without_recordings_is_a_wrong_use(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_bytes(write_model(stage_model(axis_model())))
    done = CliRunner().invoke(
        app, ["diagnose", str(tmp_path / "model.json"), "--out", str(tmp_path / "o")]
    )
    assert done.exit_code == 2
    assert "name recordings after it" in done.output


def stumbling(view: View) -> str:
    """Somebody's effect, with a mistake that only a long stroke shows: that of axis x."""
    if view.half_stroke_m > 8e-6:
        raise RuntimeError("an index too far")
    return "it was not looked for"


@pytest.fixture(scope="module")
def crashed_run(sweeps: Path) -> Iterator[Result]:
    """What a fit says whose catalogue holds that effect, all of it in this process."""
    known = effects.effect_named("outliers")
    added = replace(known, name="stumbling", untestable=stumbling)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "EFFECTS", (*effects.EFFECTS, added))
        yield ran("fit", sweeps, "x.csv", "y.csv", "--processes=1", out="stage")


def test_a_fault_of_ours_in_a_diagnosis_leaves_model_and_report_and_ends_with_status_1(
    sweeps: Path, crashed_run: Result
) -> None:
    assert crashed_run.exit_code == 1, crashed_run.output
    said = "axis x is not diagnosed: internal error (RuntimeError: an index too far)"
    assert said in " ".join(crashed_run.output.split())
    assert set(read_model((sweeps / "stage/model.json").read_bytes()).axes) == {"x", "y"}
    page = Anatomy((sweeps / "stage/report.html").read_text())
    assert any(said in cell.text for cell in (*page.all("td"), *page.all("span", "sentence")))
    (other,) = read_diagnoses((sweeps / "stage/diagnosis.json").read_bytes())
    assert other.axis == "y"
    assert "error budget y:" in crashed_run.output
