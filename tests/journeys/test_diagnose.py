"""Recordings of today against the model of last month, and a diagnosis that stumbles."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

import piezoid.diagnosis.diagnose as engine
import piezoid.identification.fit
import piezoid_reports.render
from piezoid.diagnosis.diagnosis import Diagnosis, HeldOut
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid.identification.store import read_model, write_model
from piezoid_cli.main import app
from tests.journeys.test_fit import LOOP, write_sweep
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model

SILENT = Diagnosis(
    axis="x",
    stroke_m=2e-5,
    baseline=HeldOut(rms_m=2e-8, rms_percent=0.1),
    final=HeldOut(rms_m=2e-8, rms_percent=0.1),
    envelope_rms_m=1e-8,
    noise_floor_rms_m=1e-8,
    explained_fraction=0.0,
    findings=(),
    not_detected=(),
)


@pytest.fixture
def sweeps(tmp_path: Path) -> Path:
    late = np.concatenate([np.repeat(LOOP[:1], 9), LOOP[:-9]])
    shape = 2.0 * (LOOP + 0.05 * late)
    columns = 'columns = { time = "time [s]", voltage = "voltage [V]", displacement = "pos [um]" }'
    lines = ['[rig]\nname = "two axes"']
    for axis in "xy":
        write_sweep(tmp_path / f"{axis}.csv", shape)
        lines.append(f'[[recording]]\nfile = "{axis}.csv"\naxis = "{axis}"\n{columns}')
    (tmp_path / "lab.toml").write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.fixture
def quick_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let fit return axes known by heart: what it is about here comes after it."""
    monkeypatch.setattr(
        piezoid.identification.fit, "fit_axis", lambda _, axis, *__, **___: axis_model(axis)
    )
    monkeypatch.setattr(piezoid_reports.render, "render", lambda *_, **__: "a page")


def fitted(sweeps: Path) -> Result:
    """Fit both axes in this process: no patch of a test reaches another one."""
    files = [str(sweeps / f"{axis}.csv") for axis in "xy"]
    rest = ["--lab", str(sweeps / "lab.toml"), "--out", str(sweeps / "stage")]
    return CliRunner().invoke(app, ["fit", *files, *rest, "--processes", "1"])


def test_a_model_in_front_of_the_recordings_says_what_changed(
    sweeps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "diagnose", lambda *_, **__: SILENT)
    model = sweeps / "model.json"
    model.write_bytes(write_model(stage_model(axis_model())))
    done = CliRunner().invoke(
        app, ["diagnose", str(model), str(sweeps / "x.csv"), "--out", str(sweeps / "today")]
    )
    assert done.exit_code == 0, done.output
    record = json.loads((sweeps / "today/diagnosis.json").read_text())
    since = record["since_model"]
    assert since["model_digest"] == json.loads(model.read_text())["digest"]
    assert since["refitted_rms_m"] <= since["as_it_was_rms_m"]
    assert since["explanation"] in done.output
    assert read_diagnoses((sweeps / "today/diagnosis.json").read_bytes()) == (SILENT,)


def test_without_a_model_the_causes_are_drawn_on_a_quick_fit_of_the_recordings(
    sweeps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "diagnose", lambda *_, **__: diagnosed(finding("creep")))
    files = [str(sweeps / f"{axis}.csv") for axis in "xy"]
    lab, out = str(sweeps / "lab.toml"), sweeps / "diag"
    done = CliRunner().invoke(app, ["diagnose", *files, "--lab", lab, "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "next: Record another." in done.output
    page = Anatomy((out / "diagnosis.html").read_text())
    assert len(page.all("figure")) == 1
    assert any("a quick fit of eight plays" in e.text for e in page.all("p"))
    assert not page.all("p", "alarm")


def test_recordings_that_tell_nothing_of_the_axis_are_named(
    sweeps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "diagnose", lambda *_, **__: diagnosed(finding("creep")))
    files, lab = [str(sweeps / f"{axis}.csv") for axis in "xy"], str(sweeps / "lab.toml")
    said = []
    for chosen in (files, files[:1]):
        out = str(sweeps / f"diag{len(chosen)}")
        done = CliRunner().invoke(app, ["diagnose", *chosen, "--lab", lab, "--out", out])
        said.append(" ".join(done.output.split()))
    assert "not used, for axis x rests there or has no displacement: y.csv;" in said[0]
    assert "not used" not in said[1]


def test_a_model_without_recordings_is_a_wrong_use(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_bytes(write_model(stage_model(axis_model())))
    done = CliRunner().invoke(
        app, ["diagnose", str(tmp_path / "model.json"), "--out", str(tmp_path / "o")]
    )
    assert done.exit_code == 2
    assert "name recordings behind it" in done.output


@pytest.mark.usefixtures("quick_fit")
def test_a_fault_of_ours_in_a_diagnosis_leaves_model_and_report_and_ends_with_status_1(
    sweeps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stumbling(*_: object, axis: str, **__: object) -> Diagnosis:
        if axis == "x":
            raise RuntimeError("an index too far")
        return replace(SILENT, axis=axis)

    told: dict[str, object] = {}

    def drawing(*_: object, **given: object) -> str:
        told.update(given)
        return "a page"

    monkeypatch.setattr(engine, "diagnose", stumbling)
    monkeypatch.setattr(piezoid_reports.render, "render", drawing)
    done = fitted(sweeps)
    assert done.exit_code == 1, done.output
    said = "axis x is not diagnosed: a mistake of ours, RuntimeError: an index too far"
    assert said in done.output
    assert set(read_model((sweeps / "stage/model.json").read_bytes()).axes) == {"x", "y"}
    assert told["undiagnosed"] == (said,)
    assert (sweeps / "stage/report.html").read_text() == "a page"
    (other,) = read_diagnoses((sweeps / "stage/diagnosis.json").read_bytes())
    assert other.axis == "y"


@pytest.mark.usefixtures("quick_fit")
def test_every_axis_is_diagnosed_and_the_first_stands_at_the_top(
    sweeps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "diagnose", lambda *_, axis, **__: replace(SILENT, axis=axis))
    done = fitted(sweeps)
    assert done.exit_code in (0, 1), done.output
    record = json.loads((sweeps / "stage/diagnosis.json").read_text())
    assert record["axis"] == "x"
    assert set(record["axes"]) == {"y"}
    assert "diagnosis of axis y: nothing named" in done.output
