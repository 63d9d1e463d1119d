"""`piezoid fit`: recordings in, a folder with model and report out."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import piezoid_datasets
from piezoid.errors import PiezoidError
from piezoid.identification.store import read_model
from tests.journeys.command import piezoid, run, run_process

LOOP = 10 * (1 - np.cos(2 * np.pi * np.arange(480) / 120)) / 2  # too few rows for loop shape


BUTTERFLY_um = 0.1 * (LOOP - 5) ** 2


def write_sweep(path: Path, displacement_um: np.ndarray, heading: str = "pos [um]") -> None:
    lines = [f"time [s],voltage [V],{heading}"]
    lines += [
        f"{k / 500:.3f},{u:.5f},{y:.5f}"
        for k, (u, y) in enumerate(zip(LOOP, displacement_um, strict=False))
    ]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.slow
@pytest.mark.usefixtures("one_order", "few_rows")
def test_a_bundled_sweep_gives_model_and_report(tmp_path):
    """In a separate process: test_readme.py."""
    rows = piezoid_datasets.recordings()[0].read_text().splitlines()[:1501]
    (tmp_path / "sweep.csv").write_text("\n".join(rows) + "\n")
    status, output = run("fit", tmp_path / "sweep.csv", "--out", tmp_path / "stage")
    assert status == 0, output
    assert "closure" in output
    model = read_model((tmp_path / "stage" / "model.json").read_bytes())
    terminal = " ".join(output.split())
    assert model["x"].quality.limits  # a single recording has limits
    assert all(limit.reason[1:] in terminal for limit in model["x"].quality.limits)
    assert model["x"].quality.held_out_rms_percent < 0.35
    assert model["x"].hysteresis.is_invertible
    page = (tmp_path / "stage" / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_an_axis_that_a_worker_cannot_fit_gives_one_message(tmp_path):
    write_sweep(tmp_path / "x.csv", BUTTERFLY_um[:120])
    write_sweep(tmp_path / "y.csv", np.full(len(LOOP), 2.0))
    (tmp_path / "lab.toml").write_text(
        '[[recording]]\nfile = "y.csv"\naxis = "y"\n'
        'columns = { time = "time [s]", voltage = "voltage [V]", displacement = "pos [um]" }\n'
    )
    arguments = "fit", "x.csv", "y.csv", "--lab", "lab.toml", "--out", "stage", "--quiet"
    result = run_process(*arguments, "--processes", "2", folder=tmp_path)
    assert result.returncode == 3
    assert "y.csv" in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stderr.startswith("error: ")
    assert not (tmp_path / "stage").exists()


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_an_inapplicable_model_ends_with_status_1_and_a_report(tmp_path):
    write_sweep(tmp_path / "butterfly.csv", BUTTERFLY_um)
    status, output = run("fit", tmp_path / "butterfly.csv", "--out", tmp_path / "stage")
    assert status == 1
    assert "does not apply" in output
    assert (tmp_path / "stage" / "report.html").exists()


@pytest.mark.parametrize(
    ("heading", "message"),
    [
        ("pos", "lab.toml"),  # a displacement without a unit
        ("comment", "voltage"),  # no displacement
    ],
)
def test_an_ambiguous_column_is_refused_with_the_line_to_write(tmp_path, heading, message):
    write_sweep(tmp_path / "sweep.csv", LOOP, heading)
    result = piezoid("fit", tmp_path / "sweep.csv", "--out", tmp_path / "stage")
    assert isinstance(result.exception, PiezoidError)
    assert result.exception.exit_status == 3
    assert message in str(result.exception)
    assert not (tmp_path / "stage").exists()


def test_a_missing_file_gives_one_message_and_debug_shows_the_traceback(tmp_path):
    result = run_process("fit", "nowhere.csv", "--out", "stage", folder=tmp_path)
    assert result.returncode == 3
    assert "nowhere.csv" in result.stderr
    assert "Traceback" not in result.stderr
    debugged = run_process("fit", "nowhere.csv", "--out", "stage", "--debug", folder=tmp_path)
    assert "Traceback" in debugged.stderr


def test_help_lists_the_verbs_without_slow_imports(tmp_path):
    result = run_process("--help", folder=tmp_path)
    assert result.returncode == 0
    assert "fit" in result.stdout
    code = (
        "import sys; sys.argv = ['piezoid', '--help']\n"
        "from piezoid_cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'matplotlib', 'clarabel', 'jinja2'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    imports = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert imports.returncode == 0, imports.stderr
