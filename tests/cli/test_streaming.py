"""`piezoid fit --stream` writes the folder of a stage from recordings read in chunks."""

from pathlib import Path

import numpy as np
import pytest

import piezoid_datasets
from piezoid.identification.quality import IN_SAMPLE
from piezoid.identification.store import write_model
from piezoid.records.chunked_reader import read_thinned
from piezoid.verbs import fit, read
from piezoid_cli.fit import calibrate_streamed

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order")]

ROWS = 2500  # of each of two bundled recordings


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    for name in ("x_sweep.csv", "x_check.csv"):
        rows = (piezoid_datasets.FOLDER / name).read_text().splitlines()
        (tmp_path / name).write_text("\n".join(rows[: ROWS + 1]) + "\n")
    return [tmp_path / "x_sweep.csv", tmp_path / "x_check.csv"]


def test_a_fit_in_chunks_writes_model_and_report_without_diagnosis(files):
    messages: list[str] = []
    result = calibrate_streamed(files, None, messages.append)
    assert {"model.json", "report.html"} <= set(result.files)
    assert "diagnosis.json" not in result.files
    assert b"not diagnosed" in result.files["report.html"]
    assert result.controllers.reason
    assert messages[0] == "reading x_sweep.csv"
    assert result.model["x"].quality.held_out_kind != IN_SAMPLE


def test_recordings_without_thinning_have_the_fit_from_memory(files):
    check = files[1]
    chunked = fit(read_thinned([check], chunk_rows=1024))
    assert write_model(chunked) == write_model(fit(read(check)))


def test_a_thinned_recording_gives_the_known_stage(tmp_path, rng):
    """The stage has two plays, 5 nm of noise and a lag of half a sample after thinning."""
    rate_Hz, cycles = 2000.0, 40
    t = np.arange(round(cycles * rate_Hz)) / rate_Hz
    drive_V = 5 * (0.3 + 0.7 * np.abs(np.cos(np.pi * t / 7))) * np.sin(2 * np.pi * t)
    memory, displacement_m = 0.0, np.empty(len(t))
    delayed_V = np.concatenate([np.zeros(4), drive_V[:-4]])
    for k, v in enumerate(delayed_V):
        memory = max(v - 1.0, min(v + 1.0, memory))
        displacement_m[k] = 2e-6 * v + 5e-7 * memory
    displacement_m += 5e-9 * rng.standard_normal(len(t))
    path = tmp_path / "run.csv"
    rows = np.column_stack([t, drive_V, 1e6 * displacement_m])
    header = "time [s],voltage [V],position [um]"
    np.savetxt(path, rows, "%.9g", ",", header=header, comments="")
    recordings = read_thinned([path], max_rows=1 << 14)
    assert recordings[0].sampling_rate_Hz == rate_Hz / 8
    axis = fit(recordings)["x"]
    assert axis.verdict.applies
    assert axis.quality.rms_m == pytest.approx(5e-9, rel=0.2)
    assert axis.lag.time_s == pytest.approx(2e-3, rel=0.1)
    assert axis.hysteresis.plays.weight.sum() == pytest.approx(2.5e-6, rel=0.02)
