"""`piezoid report`: a page from sealed files, with or without the recordings of the fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezoid.digests import digest_of_file
from piezoid.identification.store import write_model
from piezoid.sealed_files import read_model
from tests.journeys.command import piezoid
from tests.reports.anatomy import Anatomy
from tests.reports.known_stage import axis_model, recording, stage_model


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Write the recording of the known stage; its break is a gap in time."""
    known_recording = recording()
    time_s = np.arange(known_recording.samples) / known_recording.sampling_rate_Hz
    time_s[known_recording.breaks[0] :] += 100.0
    rows = zip(
        time_s, known_recording.voltage_V(), 1e6 * known_recording.displacement_m(), strict=True
    )
    lines = [f"{t:.4f},{u:.17g},{y:.17g}" for t, u, y in rows]
    path = tmp_path / "sweep.csv"
    path.write_text("\n".join(("time [s],voltage [V],position [um]", *lines)) + "\n")
    return path


@pytest.fixture
def stage(tmp_path: Path, sweep: Path) -> Path:
    model = stage_model(axis_model())
    sources = {**model.sources, sweep.name: digest_of_file(sweep)}
    object.__setattr__(model, "sources", sources)
    (tmp_path / "stage").mkdir()
    (tmp_path / "stage" / "model.json").write_bytes(write_model(model))
    (tmp_path / "stage" / "notes.txt").write_text("mine")
    return tmp_path / "stage"


def sections(stage: Path) -> set[str]:
    page = Anatomy((stage / "report.html").read_text(encoding="utf-8"))
    return {section.attributes["id"] for section in page.all("section")}


def test_a_page_without_recordings_states_its_missing_sections(stage):
    result = piezoid("report", stage)
    assert result.exit_code == 0, (result.output, result.exception)
    assert "without loops and residuals" in f"{result.output}{result.exception}"
    assert {"summary", "parameters", "limits", "provenance"} <= sections(stage)
    assert "loops" not in sections(stage)
    assert "made without the recordings" in (stage / "report.html").read_text()
    assert (stage / "notes.txt").read_text() == "mine"


def test_loops_are_plotted_with_the_recordings_of_the_fit(stage, sweep):
    result = piezoid("report", stage, sweep)
    assert result.exit_code == 0, (result.output, result.exception)
    assert {"loops", "residuals"} <= sections(stage)
    assert "made without the recordings" not in (stage / "report.html").read_text()


def test_missing_recordings_of_the_fit_are_named(stage, sweep):
    model = read_model((stage / "model.json").read_bytes(), "model.json")
    sources = {sweep.name: digest_of_file(sweep), "chirp.csv": "sha256:1", "run.txt": "sha256:2"}
    (stage / "model.json").write_bytes(write_model(replace(model, sources=sources)))
    result = piezoid("report", stage, sweep)
    assert result.exit_code == 0, (result.output, result.exception)
    fact = "2 of 3 recordings of the fit are missing: chirp.csv, run.txt"
    assert fact in result.output
    assert fact in (stage / "report.html").read_text(encoding="utf-8")
    (stage / "model.json").write_bytes(write_model(model))
    assert "of the fit is missing" not in piezoid("report", stage, sweep).output
    assert "of the fit is missing" not in (stage / "report.html").read_text(encoding="utf-8")


def test_a_changed_recording_is_refused_and_the_old_page_stays(stage, sweep):
    (stage / "report.html").write_text("old")
    sweep.write_text(sweep.read_text().replace("0.0000", "0.0001", 1))
    result = piezoid("report", stage, sweep, "--force")
    assert result.exit_code != 0
    assert "sweep.csv has other contents" in f"{result.output}{result.exception}"
    assert (stage / "report.html").read_text() == "old"


def test_a_changed_bit_is_refused_and_the_old_page_stays(stage):
    assert piezoid("report", stage).exit_code == 0
    (stage / "report.html").write_text("old")
    content = (stage / "model.json").read_bytes()
    (stage / "model.json").write_bytes(content.replace(b"bench", b"bench2", 1))
    result = piezoid("report", stage, "--force")
    assert result.exit_code != 0
    assert "digest" in f"{result.output}{result.exception}"
    assert (stage / "report.html").read_text() == "old"
