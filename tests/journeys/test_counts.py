"""Sensors without calibration, and drives as the converter has them: a file in, words out."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

import piezoid
from piezoid.identification.parameters import parameters_of
from piezoid.identification.store import read_model
from piezoid.raw_counts import in_counts
from piezoid_cli.batch_stage import StageTask, calibrate_stage
from tests.journeys.command import piezoid as run
from tests.laws import RATE_Hz, swept_um

# Units in what people read: a number or a label with metres or volts, prefix or not.
METRES = re.compile(
    r"(?:\d[ \u202f\xa0]|[\[(])[pnuµmk]?m(?:/[A-Za-z]+)?(?![\w])|\bmetre|\b[nuµ]m\b"
)
VOLTS = re.compile(r"(?:\d[ \u202f\xa0]|[\[(]|m/)[nuµmk]?V(?![\w])|\bvolts?\b")
OURS = re.compile(r"voltage offset|'?DAC voltage|a voltage in|voltage =|the voltage")


def shown(page: Path) -> str:
    """Return what a reader sees of a page, labels of figures included."""
    content = re.sub(r"<(style|script).*?</\1>", "", page.read_text(), flags=re.DOTALL)
    labels = re.findall(r'(?:aria-label|title|data-[xy]-unit)="([^"]*)"', content)
    return html.unescape(re.sub(r"<[^>]*>", " ", content) + " ".join(labels))


def write_in_counts(path: Path, law: str, *, drive: str, scale: float) -> Path:
    """Write a sweep with its displacement in counts, and its drive in volts or in counts."""
    field, reading_um = swept_um(law)
    time_s = np.arange(len(field)) / RATE_Hz
    table = np.column_stack([time_s, scale * 5.0 * field, np.round(1e3 * reading_um)])
    heading = f"time [s],{drive},position [counts]"
    np.savetxt(path, table, delimiter=",", header=heading, comments="", fmt="%.6g")
    return path


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_stage_in_counts_is_told_in_counts_everywhere(tmp_path):
    """Displacement and drive; where the drive is in volts: the test below."""
    place = tmp_path / "sweep.csv"
    sweep = write_in_counts(place, "dahl", drive="DAC voltage [LSB]", scale=3276.8)
    done = run("fit", sweep, "--out", tmp_path / "stage")
    assert done.exit_code in (0, 1)
    assert "counts" in done.output
    model = json.loads((tmp_path / "stage/model.json").read_text())["axes"]["x"]
    assert model["counted"] == ["displacement", "voltage"]
    assert 1e4 < model["quality"]["range_m"] < 3e4  # the counts of the file
    found = json.loads((tmp_path / "stage/diagnosis.json").read_text())
    assert found["counted"] == ["displacement", "voltage"]
    assert {one["unit"] for one in found["not_detected"]} == {"counts, rms"}
    assert not (tmp_path / "stage/design.json").exists()
    assert "the size of one count in m" in " ".join(done.output.split())
    run("diagnose", sweep, "--out", tmp_path / "causes")
    told = (
        done.output,
        shown(tmp_path / "stage/report.html"),
        shown(tmp_path / "causes/diagnosis.html"),
        json.dumps(found["findings"]) + json.dumps(model["verdict"]),
    )
    for said in told:
        assert not METRES.search(said), said[max(METRES.search(said).start() - 60, 0) :][:120]
        plain = OURS.sub("", said)
        assert not VOLTS.search(plain), plain[max(VOLTS.search(plain).start() - 60, 0) :][:120]


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_counts_and_metres_of_one_stage_give_the_same_model(tmp_path):
    sweep = write_in_counts(tmp_path / "sweep.csv", "duhem", drive="voltage [V]", scale=1.0)
    (tmp_path / "lab.toml").write_text(
        '[[recording]]\nfile = "sweep.csv"\nscale = { displacement = 1e-9 }\n'
    )
    lab = tmp_path / "batch/lab.toml"
    lab.parent.mkdir()
    lab.write_text("")
    (lab.parent / "sweep.csv").write_bytes(sweep.read_bytes())
    task = StageTask(name="a", folder=str(lab.parent), results=str(tmp_path), version="")
    stage, files = calibrate_stage(task, {"sweep.csv": "", "lab.toml": ""})
    raw = read_model(files["model.json"])["x"]
    # Stages are compared in units: what is in counts is left out there.
    assert {"lag_s", "held_out_rms_percent"} <= set(stage.axes[0].values)
    assert not {"noise_rms_m", "sensitivity_m_per_V"} & set(stage.axes[0].values)
    known = piezoid.fit(piezoid.read(sweep, lab=tmp_path / "lab.toml"))["x"]
    assert (raw.counted, known.counted) == (("displacement",), ())
    in_counts_percent = piezoid.fit(piezoid.read(sweep))["x"].quality.held_out_rms_percent
    assert in_counts_percent == pytest.approx(known.quality.held_out_rms_percent, rel=1e-6)
    assert set(parameters_of(raw)["unit"]) >= {"counts", "counts/V"}
    assert piezoid.plot(raw).get_ylabel() == "displacement of x (kcounts)"
    assert piezoid.plot(known).get_ylabel() == "displacement of x (µm)"


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_nothing_in_counts_is_played_or_shipped(tmp_path):
    sweep = write_in_counts(tmp_path / "sweep.csv", "plays", drive="drive [counts]", scale=3276.8)
    stage = tmp_path / "stage"
    done = run("fit", sweep, "--out", stage, "--stream")
    assert "counts" in done.output
    assert not METRES.search(done.output)
    assert not METRES.search(shown(stage / "report.html"))
    for verb in (("design", stage), ("learn", stage, "--reference", sweep, "--out", tmp_path)):
        refused = run(*verb)
        assert refused.exit_code != 0
        assert not (stage / "design.json").exists()
    assert "scale = { displacement = ... }" in str(run("design", stage).exception)


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("33.2 km, noise 9.5 m", "33.2 kcounts, noise 9.5 counts"),
        ("12 µm/V at 3 V", "12 µcounts/V at 3 V"),
        ("(5.8 ± 0.1) km", "(5.8 ± 0.1) kcounts"),
        ("m, rms", "counts, rms"),
        ("nm/√Hz", "ncounts/√Hz"),
        ("M12,3l0,1m4", "M12,3l0,1m4"),
        ("play_weight_m_per_V[0] of I am", "play_weight_m_per_V[0] of I am"),
        ("2 ms, 5 Hz, 3 mm/s", "2 ms, 5 Hz, 3 mcounts/s"),
    ],
)
def test_units_become_counts_and_words_stay(said, told):
    assert in_counts(said, ("displacement",)) == told
    assert in_counts(said, ()) == said
