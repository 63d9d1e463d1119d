"""`piezoid diagnose`: with an earlier model, with a crashing effect, and without a drive."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

import piezoid_datasets
from piezoid.diagnosis import effects
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid.errors import ExcitationError
from piezoid.identification.store import read_model, write_model
from piezoid.records.collection import collect
from piezoid_cli.main import app
from tests.diagnosis.bench import finding_of
from tests.laws import LAWS, RATE_Hz, triangles
from tests.laws import write as write_sweep
from tests.plays_alone import fit_one_order, fit_plays_alone
from tests.reports.anatomy import Anatomy
from tests.reports.known_stage import axis_model, stage_model

STEP_um = {"x": 0.5, "y": 0.25}
COLUMNS = 'columns = { time = "time [s]", voltage = "voltage [V]", displacement = "pos [um]" }'


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write four loops of each of two axes with coarse sensors, and an earlier model."""
    folder = tmp_path_factory.mktemp("sweeps")
    k = np.arange(240)
    drive_V = 5.0 * (1.0 - np.cos(2.0 * np.pi * k / 60.0))
    delayed_V = np.concatenate([np.repeat(drive_V[:1], 3), drive_V[:-3]])
    lines = ['[rig]\nname = "two axes"']
    for axis, step_um in STEP_um.items():
        noise_um = 0.005 * np.random.default_rng(1).standard_normal(len(k))
        displacement_um = 4.0 * step_um * (drive_V + 0.05 * delayed_V) + noise_um
        reading_um = np.round(displacement_um / step_um) * step_um
        rows = zip(k / 100.0, drive_V, reading_um, strict=True)
        text = "".join(f"{t},{u:.5f},{y:.5f}\n" for t, u, y in rows)
        (folder / f"{axis}.csv").write_text(f"time [s],voltage [V],pos [um]\n{text}")
        lines.append(f'[[recording]]\nfile = "{axis}.csv"\naxis = "{axis}"\n{COLUMNS}')
    (folder / "lab.toml").write_text("\n".join(lines) + "\n")
    (folder / "model.json").write_bytes(write_model(stage_model(axis_model())))
    return folder


def run_verb(verb: str, folder: Path, *files: str, out: str) -> Result:
    arguments = [file if file[0] == "-" else str(folder / file) for file in files]
    options = ["--lab", str(folder / "lab.toml"), "--out", str(folder / out)]
    with pytest.MonkeyPatch.context() as patch:
        fit_plays_alone(patch)
        fit_one_order(patch)
        return CliRunner(env={"COLUMNS": "200"}).invoke(app, [verb, *arguments, *options])


@pytest.fixture(scope="module")
def today(sweeps: Path) -> Result:
    """Diagnose axis x with an earlier model."""
    return run_verb("diagnose", sweeps, "model.json", "x.csv", out="today")


@pytest.fixture(scope="module")
def without_model(sweeps: Path) -> Result:
    """Diagnose the recordings of both axes without a model."""
    return run_verb("diagnose", sweeps, "x.csv", "y.csv", out="plain")


def test_a_diagnosis_with_a_model_states_what_changed(sweeps, today):
    assert today.exit_code == 0, today.output
    content = (sweeps / "today/diagnosis.json").read_bytes()
    change = json.loads(content)["since_model"]
    assert change["model_digest"] == json.loads((sweeps / "model.json").read_text())["digest"]
    assert change["refitted_rms_m"] <= change["as_it_was_rms_m"]
    assert " ".join(change["explanation"].split()) in " ".join(today.output.split())
    (diagnosis,) = read_diagnoses(content)
    assert set(diagnosis.names) <= {"quantisation", "loop_shape"}
    assert "quantisation" in diagnosis.names


def test_without_a_model_the_axis_is_fitted_and_its_budget_adds_up(sweeps, without_model):
    assert without_model.exit_code == 0, without_model.output
    (diagnosis,) = read_diagnoses((sweeps / "plain/diagnosis.json").read_bytes())
    finding = finding_of(diagnosis, "quantisation")
    assert finding.size.value == pytest.approx(1e3 * STEP_um["x"])
    power_m2 = sum(part.rms_m**2 for part in diagnosis.budget)
    assert power_m2 == pytest.approx(diagnosis.baseline.rms_m**2)
    page = Anatomy((sweeps / "plain/diagnosis.html").read_text())
    assert len(page.all("figure", "chart")) == 1
    assert not page.all("p", "alarm")


def test_recordings_without_data_of_the_axis_are_named(today, without_model):
    output = " ".join(without_model.output.split())
    assert "not used: y.csv (axis x does not move or was not recorded" in output
    assert "not used" not in today.output


def test_a_model_without_recordings_is_a_usage_error(tmp_path):
    (tmp_path / "model.json").write_bytes(write_model(stage_model(axis_model())))
    result = CliRunner().invoke(
        app, ["diagnose", str(tmp_path / "model.json"), "--out", str(tmp_path / "o")]
    )
    assert result.exit_code == 2
    assert "name recordings after it" in result.output


def crashing(view: View) -> str:
    """Crash for strokes as long as that of axis x."""
    if view.half_stroke_m > 8e-6:
        raise RuntimeError("an index too far")
    return "it was not looked for"


@pytest.fixture
def crashed_run(sweeps: Path) -> Iterator[Result]:
    """Fit with a catalogue that contains the crashing effect."""
    outliers = effects.effect_named("outliers")
    crashing_effect = replace(outliers, name="stumbling", untestable=crashing)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "EFFECTS", (*effects.EFFECTS, crashing_effect))
        yield run_verb("fit", sweeps, "x.csv", "y.csv", "--processes=1", out="stage")


def test_a_crashing_effect_leaves_model_and_report_and_ends_with_status_1(sweeps, crashed_run):
    assert crashed_run.exit_code == 1, crashed_run.output
    message = "axis x is not diagnosed: internal error (RuntimeError: an index too far)"
    assert message in " ".join(crashed_run.output.split())
    assert set(read_model((sweeps / "stage/model.json").read_bytes()).axes) == {"x", "y"}
    page = Anatomy((sweeps / "stage/report.html").read_text())
    assert any(message in cell.text for cell in (*page.all("td"), *page.all("span", "sentence")))
    (diagnosis,) = read_diagnoses((sweeps / "stage/diagnosis.json").read_bytes())
    assert diagnosis.axis == "y"
    assert "error budget y:" in crashed_run.output


@pytest.mark.slow
@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_an_unknown_tone_is_named_with_its_frequency_and_plotted(tmp_path):
    """One period of the recording from the third harmonic of the drive, it is not a lag."""
    field = triangles(6, 500)
    tone_Hz = 2.83 * RATE_Hz / 500
    tone_um = 0.2 * np.sin(2.0 * np.pi * tone_Hz * np.arange(len(field)) / RATE_Hz)
    noise_um = 0.008 * np.random.default_rng(4).standard_normal(len(field))
    reading_um = 10.0 * LAWS["duhem"](field) + tone_um + noise_um
    sweep, out = write_sweep(tmp_path / "sweep.csv", field, reading_um), tmp_path / "diag"
    result = CliRunner().invoke(app, ["diagnose", str(sweep), "--out", str(out)])
    assert result.exit_code == 0, result.output
    record = json.loads((out / "diagnosis.json").read_text())
    (finding,) = record["findings"]
    assert (finding["effect"], finding["coordinate"]) == ("something_else", "frequency")
    assert finding["parameters"]["frequency_Hz"] == pytest.approx(tone_Hz, rel=0.02)
    assert finding["size"]["value"] == pytest.approx(200.0 / np.sqrt(2.0), rel=0.15)
    assert f"{finding['parameters']['frequency_Hz']:.5g} Hz" in " ".join(result.output.split())
    assert record["unexplained"]["p_value"] < 0.05
    assert "something_else" not in {absent["effect"] for absent in record["not_detected"]}
    page = (out / "diagnosis.html").read_text()
    assert "residual against the part of a period" in page


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_sweep_a_thousand_times_slower_is_fitted_and_diagnosed(tmp_path):
    """Hours instead of seconds: a parameter that one block determines is dominated by rounding."""
    lines = piezoid_datasets.recordings()[0].read_text().splitlines()[:1501]
    rows = [line.partition(",") for line in lines[1:]]
    text = "".join(f"{1000.0 * float(time):.0f},{columns}\n" for time, _, columns in rows)
    (tmp_path / "slow.csv").write_text(f"{lines[0]}\n{text}")
    words = ["diagnose", str(tmp_path / "slow.csv"), "--out", str(tmp_path / "out"), "--quiet"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, (result.output, result.exception)
    (diagnosis,) = read_diagnoses((tmp_path / "out/diagnosis.json").read_bytes())
    assert diagnosis.axis == "x"


NO_DRIVE = "Time (s)\tZ (m)"
SPECTROSCOPY = "Z rel (m)\tCurrent (A)"


def write(path: Path, experiment: str, names: str) -> Path:
    """Write a Nanonis file of two columns."""
    rows = np.column_stack([np.linspace(0.0, 10.0, 400), np.linspace(0.0, 1e-9, 400)])
    lines = ["\t".join(f"{value:.9e}" for value in row) for row in rows]
    path.write_text(
        f"Experiment\t{experiment}\t\nBias>Bias (V)\t0E+0\t\n\n[DATA]\n"
        + "\n".join([names, *lines])
        + "\n"
    )
    return path


@pytest.mark.parametrize(
    ("experiment", "names", "message"),
    [("history", NO_DRIVE, "only displacement"), ("Z spectroscopy", SPECTROSCOPY, "no recording")],
)
def test_a_file_without_a_drive_is_refused_with_the_missing_quantity(
    tmp_path, experiment, names, message
):
    recordings = collect([write(tmp_path / "drift.dat", experiment, names)])
    with pytest.raises(ExcitationError, match=f"{message}.*a drive voltage and a displacement"):
        diagnose(recordings.recordings)


def test_an_unknown_axis_is_refused_by_its_name():
    recordings = collect([Path("datasets/x_check.csv")])
    with pytest.raises(ExcitationError, match="displacement of axis y"):
        diagnose(recordings.recordings, axis="y")
