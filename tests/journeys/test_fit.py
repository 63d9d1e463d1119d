"""What a lab types first: recordings in, a folder with model and report out."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import piezoid_datasets
from piezoid.errors import PiezoidError
from piezoid.identification.store import read_model
from tests.journeys.command import piezoid, run, started

LOOP = 10 * (1 - np.cos(2 * np.pi * np.arange(480) / 120)) / 2  # few rows: no loop shape


BUTTERFLY_um = 0.1 * (LOOP - 5) ** 2


def write_sweep(path: Path, displacement_um: np.ndarray, heading: str = "pos [um]") -> None:  # type: ignore[type-arg]
    lines = [f"time [s],voltage [V],{heading}"]
    lines += [
        f"{k / 500:.3f},{u:.5f},{y:.5f}"
        for k, (u, y) in enumerate(zip(LOOP, displacement_um, strict=False))
    ]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.slow
def test_bundled_sweep_becomes_model_and_report(tmp_path: Path) -> None:
    rows = piezoid_datasets.recordings()[0].read_text().splitlines()[:1501]
    (tmp_path / "sweep.csv").write_text("\n".join(rows) + "\n")
    done = started("fit", "sweep.csv", "--out", "stage", place=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "closure" in done.stdout
    model = read_model((tmp_path / "stage" / "model.json").read_bytes())
    terminal = " ".join(done.stdout.split())
    assert model["x"].quality.limits  # one recording: usable with care
    assert all(limit.reason[1:] in terminal for limit in model["x"].quality.limits)
    assert model["x"].quality.held_out_rms_percent < 0.35
    assert model["x"].hysteresis.is_invertible
    page = (tmp_path / "stage" / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "Traceback" not in done.stderr


def test_an_axis_that_another_process_cannot_fit_is_one_message(tmp_path: Path) -> None:
    write_sweep(tmp_path / "x.csv", BUTTERFLY_um[:120])
    write_sweep(tmp_path / "y.csv", np.full(len(LOOP), 2.0))
    (tmp_path / "lab.toml").write_text(
        '[[recording]]\nfile = "y.csv"\naxis = "y"\n'
        'columns = { time = "time [s]", voltage = "voltage [V]", displacement = "pos [um]" }\n'
    )
    given = "fit", "x.csv", "y.csv", "--lab", "lab.toml", "--out", "stage", "--quiet"
    done = started(*given, "--processes", "2", place=tmp_path)
    assert done.returncode == 3
    assert "y.csv" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("error: ")
    assert not (tmp_path / "stage").exists()


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_class_that_does_not_apply_ends_with_status_1_and_a_report(tmp_path: Path) -> None:
    write_sweep(tmp_path / "butterfly.csv", BUTTERFLY_um)
    status, shown = run("fit", tmp_path / "butterfly.csv", "--out", tmp_path / "stage")
    assert status == 1
    assert "does not apply" in shown
    assert (tmp_path / "stage" / "report.html").exists()


@pytest.mark.parametrize(
    ("heading", "said"),
    [
        ("pos", "lab.toml"),  # a displacement without a unit
        ("comment", "voltage"),  # nothing that could be a displacement
    ],
)
def test_what_is_ambiguous_is_refused_with_the_line_to_write(
    tmp_path: Path, heading: str, said: str
) -> None:
    write_sweep(tmp_path / "sweep.csv", LOOP, heading)
    done = piezoid("fit", tmp_path / "sweep.csv", "--out", tmp_path / "stage")
    assert isinstance(done.exception, PiezoidError)
    assert done.exception.exit_status == 3
    assert said in str(done.exception)
    assert not (tmp_path / "stage").exists()


def test_a_missing_file_is_one_message_and_debug_brings_the_traceback(tmp_path: Path) -> None:
    done = started("fit", "nowhere.csv", "--out", "stage", place=tmp_path)
    assert done.returncode == 3
    assert "nowhere.csv" in done.stderr
    assert "Traceback" not in done.stderr
    again = started("fit", "nowhere.csv", "--out", "stage", "--debug", place=tmp_path)
    assert "Traceback" in again.stderr


def test_help_names_the_verbs_and_loads_nothing_heavy(tmp_path: Path) -> None:
    done = started("--help", place=tmp_path)
    assert done.returncode == 0
    assert "fit" in done.stdout
    code = (
        "import sys; sys.argv = ['piezoid', '--help']\n"
        "from piezoid_cli.main import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'matplotlib', 'clarabel', 'jinja2'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    checked = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stderr
