"""A sweep of hours is a sweep like any other."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

import piezoid_datasets
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid_cli.main import app

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")


def test_a_sweep_a_thousand_times_slower_is_fitted_and_diagnosed(tmp_path: Path) -> None:
    """Hours for what took seconds: what one block alone determines is nothing but rounding."""
    lines = piezoid_datasets.recordings()[0].read_text().splitlines()[:1501]
    rows = [line.partition(",") for line in lines[1:]]
    text = "".join(f"{1000.0 * float(time):.0f},{rest}\n" for time, _, rest in rows)
    (tmp_path / "slow.csv").write_text(f"{lines[0]}\n{text}")
    words = ["diagnose", str(tmp_path / "slow.csv"), "--out", str(tmp_path / "out"), "--quiet"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, (done.output, done.exception)
    (found,) = read_diagnoses((tmp_path / "out/diagnosis.json").read_bytes())
    assert found.axis == "x"
