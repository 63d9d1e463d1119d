"""The units in a file's headings change what is written there, and not the stage that is found."""

from pathlib import Path

import numpy as np
from typer.testing import CliRunner

import piezoid_datasets
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses
from piezoid.identification.fit import fit
from piezoid.records.ingest import ingest
from piezoid_cli.main import app
from tests.identification.hysteresis.stages import RATE_Hz, decaying
from tests.identification.hysteresis.test_estimate import stage


def write_columns(path: Path, headings: str, *columns: np.ndarray) -> None:  # type: ignore[type-arg]
    # Seventeen digits: the numbers differ by rounding only.
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=headings, comments="")


def test_millivolts_nanometres_and_milliseconds_give_the_stage_of_si_units(
    tmp_path: Path,
) -> None:
    drive = decaying(7, per_unit=20)
    response = stage(drive, np.random.default_rng(5))
    time_s = np.arange(len(drive)) / RATE_Hz
    plain, other = tmp_path / "plain.csv", tmp_path / "other.csv"
    write_columns(plain, "time [s],voltage [V],position [m]", time_s, drive, response)
    write_columns(
        other, "time [ms],voltage [mV],position [nm]", time_s * 1e3, drive * 1e3, response * 1e9
    )
    found, wanted = (fit([ingest(path)])["x"] for path in (other, plain))
    plays, known = found.hysteresis.plays, wanted.hysteresis.plays
    np.testing.assert_allclose(plays.threshold, known.threshold, rtol=1e-6)
    np.testing.assert_allclose(plays.weight, known.weight, rtol=1e-6)
    np.testing.assert_allclose(found.lag.time_s, wanted.lag.time_s, rtol=1e-6)
    np.testing.assert_allclose(
        found.quality.held_out_rms_m, wanted.quality.held_out_rms_m, rtol=1e-6
    )


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
