"""Raw counts of sensor and converter are kept as counts in all results and texts."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

import piezoid
from piezoid.identification.actuator_model import parameters_of
from piezoid.identification.store import read_model
from piezoid.raw_counts import in_counts
from piezoid_cli.batch_stage import StageTask, calibrate_stage
from tests.journeys.command import piezoid as run
from tests.laws import RATE_Hz, swept_um

# Units for readers: a number or a label with metres or volts, with or without prefix.
METRES = re.compile(
    r"(?:\d[ \u202f\xa0]|[\[(])[pnuµmk]?m(?:/[A-Za-z]+)?(?![\w])|\bmetre|\b[nuµ]m\b"
)
VOLTS = re.compile(r"(?:\d[ \u202f\xa0]|[\[(]|m/)[nuµmk]?V(?![\w])|\bvolts?\b")
NAMES_WITH_VOLTAGE = re.compile(r"voltage offset|'?DAC voltage|a voltage in|voltage =|the voltage")


def visible_text(page: Path) -> str:
    """Return the visible text of a page, including labels of figures."""
    content = re.sub(r"<(style|script).*?</\1>", "", page.read_text(), flags=re.DOTALL)
    labels = re.findall(r'(?:aria-label|title|data-[xy]-unit)="([^"]*)"', content)
    return html.unescape(re.sub(r"<[^>]*>", " ", content) + " ".join(labels))


def write_in_counts(path: Path, law: str, *, drive: str, scale: float) -> Path:
    """Write a sweep with displacement in counts, and drive in volts or counts."""
    field, reading_um = swept_um(law)
    time_s = np.arange(len(field)) / RATE_Hz
    table = np.column_stack([time_s, scale * 5.0 * field, np.round(1e3 * reading_um)])
    heading = f"time [s],{drive},position [counts]"
    np.savetxt(path, table, delimiter=",", header=heading, comments="", fmt="%.6g")
    return path


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_stage_in_counts_is_described_in_counts_everywhere(tmp_path):
    """Displacement and drive are in counts. Drive in volts: the test below."""
    path = tmp_path / "sweep.csv"
    sweep = write_in_counts(path, "dahl", drive="DAC voltage [LSB]", scale=3276.8)
    result = run("fit", sweep, "--out", tmp_path / "stage")
    assert result.exit_code in (0, 1)
    assert "counts" in result.output
    model = json.loads((tmp_path / "stage/model.json").read_text())["axes"]["x"]
    assert model["counted"] == ["displacement", "voltage"]
    assert 1e4 < model["quality"]["range_m"] < 3e4  # counts
    diagnosis = json.loads((tmp_path / "stage/diagnosis.json").read_text())
    assert diagnosis["counted"] == ["displacement", "voltage"]
    assert {absent["unit"] for absent in diagnosis["not_detected"]} == {"counts, rms"}
    assert not (tmp_path / "stage/design.json").exists()
    assert "the size of one count in m" in " ".join(result.output.split())
    run("diagnose", sweep, "--out", tmp_path / "causes")
    texts = (
        result.output,
        visible_text(tmp_path / "stage/report.html"),
        visible_text(tmp_path / "causes/diagnosis.html"),
        json.dumps(diagnosis["findings"]) + json.dumps(model["verdict"]),
    )
    for text in texts:
        assert not METRES.search(text), text[max(METRES.search(text).start() - 60, 0) :][:120]
        other_text = NAMES_WITH_VOLTAGE.sub("", text)
        assert not VOLTS.search(other_text), other_text[
            max(VOLTS.search(other_text).start() - 60, 0) :
        ][:120]


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
    # Stages are compared in units, so quantities in counts are omitted.
    assert {"lag_s", "held_out_rms_percent"} <= set(stage.axes[0].values)
    assert not {"noise_rms_m", "sensitivity_m_per_V"} & set(stage.axes[0].values)
    calibrated = piezoid.fit(piezoid.read(sweep, lab=tmp_path / "lab.toml"))["x"]
    assert (raw.counted, calibrated.counted) == (("displacement",), ())
    in_counts_percent = piezoid.fit(piezoid.read(sweep))["x"].quality.held_out_rms_percent
    assert in_counts_percent == pytest.approx(calibrated.quality.held_out_rms_percent, rel=1e-6)
    assert set(parameters_of(raw)["unit"]) >= {"counts", "counts/V"}
    assert piezoid.plot(raw).get_ylabel() == "displacement of x (kcounts)"
    assert piezoid.plot(calibrated).get_ylabel() == "displacement of x (µm)"


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_no_controller_is_designed_or_learned_in_counts(tmp_path):
    sweep = write_in_counts(tmp_path / "sweep.csv", "plays", drive="drive [counts]", scale=3276.8)
    stage = tmp_path / "stage"
    result = run("fit", sweep, "--out", stage, "--stream")
    assert "counts" in result.output
    assert not METRES.search(result.output)
    assert not METRES.search(visible_text(stage / "report.html"))
    for verb in (("design", stage), ("learn", stage, "--reference", sweep, "--out", tmp_path)):
        result_of_verb = run(*verb)
        assert result_of_verb.exit_code != 0
        assert not (stage / "design.json").exists()
    assert "scale = { displacement = ... }" in str(run("design", stage).exception)


@pytest.mark.parametrize(
    ("text", "expected"),
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
def test_units_become_counts_and_words_are_unchanged(text, expected):
    assert in_counts(text, ("displacement",)) == expected
    assert in_counts(text, ()) == text
