"""`piezoid fit` on Z spectroscopies of a tunnelling microscope."""

import json
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import RecordingError
from piezoid.identification.fit import fit as fit_model
from piezoid.identification.fit import refuse_duplicate_names
from piezoid.records.collection import collect
from tests.journeys.command import run

DECAY_per_m = 20e9  # (20 / 10.246)^2 = 3.81 eV
FLOOR_A = 2e-14


def write_sweep(path: Path, rng: np.random.Generator, *, top_A: float = 5e-10) -> Path:
    """Write a Z spectroscopy of 150 heights over 0.6 nm, forward and backward."""
    height_m = np.linspace(0.0, 6e-10, 150)
    law_A = top_A * np.exp(-DECAY_per_m * height_m)
    noisy = [
        law_A * (1 + 0.01 * rng.normal(size=150)) + FLOOR_A * rng.normal(size=150)
        for _ in range(2)
    ]
    rows = np.column_stack([height_m, *noisy])
    text = "\n".join("\t".join(f"{value:.9e}" for value in row) for row in rows)
    path.write_text(
        "Experiment\tZ spectroscopy\t\nBias>Bias (V)\t20E-3\t\n\n[DATA]\n"
        f"Z rel (m)\tCurrent (A)\tCurrent [bwd] (A)\n{text}\n"
    )
    return path


def test_a_spectroscopy_gives_barrier_model_and_report(tmp_path, rng):
    status, output = run("fit", write_sweep(tmp_path / "z.dat", rng), "--out", tmp_path / "stage")
    assert status == 0
    assert "Apparent barrier 3.8" in output
    record = json.loads((tmp_path / "stage" / "model.json").read_bytes())
    low, high = record["tunnelling"]["gap_law"]["decay_interval_per_m"]
    assert low < DECAY_per_m < high
    assert record["axes"] == {}
    page = (tmp_path / "stage" / "report.html").read_text()
    for words in ('id="summary"', 'id="tunnelling"', "Residual of the gap law"):
        assert words in page
    assert 'id="loops"' not in page


def test_a_weak_spectroscopy_has_low_confidence_with_its_reasons(tmp_path, rng):
    weak = write_sweep(tmp_path / "weak.dat", rng, top_A=20 * FLOOR_A)
    _, output = run("fit", weak, "--out", tmp_path / "stage")
    assert "low confidence" in output
    assert "decades above three times its noise" in output
    assert (
        "decades above three times its noise" in (tmp_path / "stage" / "report.html").read_text()
    )


def test_two_files_of_one_name_are_refused_before_the_fit(tmp_path, rng):
    folders = [tmp_path / "monday", tmp_path / "friday"]
    for folder in folders:
        folder.mkdir()
    collection = collect([write_sweep(folder / "z.dat", rng) for folder in folders])
    with pytest.raises(RecordingError, match=r"named z\.dat.*Rename"):
        fit_model(collection.recordings, sweeps=collection.sweeps)


def test_a_repeated_recording_is_refused_and_two_axes_of_one_file_are_not():
    from tests.reports.known_stage import recording

    x, y = recording("sweep.csv", "x"), recording("sweep.csv", "y")
    refuse_duplicate_names([x, y])
    with pytest.raises(RecordingError, match=r"sweep\.csv"):
        refuse_duplicate_names([x, x])


def test_a_current_over_time_is_stated_to_be_unused(tmp_path, rng):
    time_s = np.arange(400) / 1000.0
    lines = [f"{t:.3f},{np.sin(40 * t):.6f},{1e-9:.3e}" for t in time_s]
    loop = tmp_path / "loop.csv"
    loop.write_text("time [s],voltage [V],current [A]\n" + "\n".join(lines) + "\n")
    collection = collect([loop, write_sweep(tmp_path / "z.dat", rng)])
    model = fit_model(collection.recordings, sweeps=collection.sweeps)
    assert len(model.remarks) == 1
    assert model.remarks[0].startswith("loop.csv")
    assert "dither" in model.remarks[0]


def test_the_published_recording_gives_the_published_decay(realdata, tmp_path):
    path = realdata / "stm_current_vs_z" / "z.dat"
    status, output = run("fit", path, "--out", tmp_path / "stage")
    assert status == 0
    assert "high confidence" in output
    record = json.loads((tmp_path / "stage" / "model.json").read_bytes())["tunnelling"]
    # Published fits: 20.60 and 20.76 per nm; agreement within half a percent.
    assert record["forward"]["decay_per_m"] == pytest.approx(20.60e9, rel=5e-3)
    assert record["backward"]["decay_per_m"] == pytest.approx(20.76e9, rel=5e-3)
    low, high = record["gap_law"]["decay_interval_per_m"]
    assert low < 20.68e9 < high
