"""`piezoid fit` on a tunnelling tip under closed-loop control, simulated by `piezoid simulate`."""

import json
import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piezoid.errors import LabFileError
from piezoid.identification.store import read_model, write_model
from piezoid.identification.tunnelling.loop_files import loops_of
from piezoid.records.collection import collect
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab, read_lab
from tests.journeys.command import run

pytestmark = pytest.mark.slow

RANGE = ("input_range_V", "dac_bits", "adc_bits")  # of the converters


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulate three spots of two seconds without converter ranges, so nothing is designed."""
    out = tmp_path_factory.mktemp("tip") / "made"
    status, output = run("simulate", "--out", out, "--seed", "7", "--junction", "2.1")
    assert status == 0, output
    lab = out / "recordings" / "lab.toml"
    lines = lab.read_text().splitlines(keepends=True)
    lab.write_text("".join(line for line in lines if not line.startswith(RANGE)))
    return out


@pytest.fixture(scope="module")
def fitted(simulated: Path) -> tuple[Path, str]:
    folder = simulated / "recordings"
    files = [*sorted(folder.glob("loop_*.csv")), folder / "spectroscopy.dat"]
    status, output = run("fit", *files, "--lab", folder / "lab.toml", "--out", simulated / "fit")
    assert status == 0, output
    return simulated / "fit", output


@pytest.fixture(scope="module")
def junction(fitted: tuple[Path, str]) -> dict[str, Any]:
    tunnelling: dict[str, Any] = json.loads((fitted[0] / "model.json").read_bytes())["tunnelling"]
    return tunnelling


@pytest.fixture(scope="module")
def truths(simulated: Path) -> dict[str, Any]:
    junctions: dict[str, Any] = json.loads((simulated / "truth" / "truth.json").read_text())[
        "junctions"
    ]
    return junctions


def test_gain_sensor_pole_and_delay_lie_in_their_intervals(junction, truths):
    loop = junction["loop_plant"]
    gains = [truth["gain_nepers_per_V"] for truth in truths.values()]
    low, high = loop["gain_interval"]
    assert low < math.exp(np.mean(np.log(gains))) < high
    spot = next(iter(truths.values()))
    low, high = loop["sensor_pole_interval_Hz"]
    assert low < spot["sensor_pole_Hz"] < (math.inf if high is None else high)
    low, high = loop["delay_interval_s"]
    assert low < spot["latency_s"] < high
    assert loop["axis"] == "z"
    assert loop["family_records"] == 3


def test_the_barrier_of_every_spot_is_identified_and_the_naive_estimate_is_wrong(junction, truths):
    for record in junction["loop_plant"]["records"]:
        truth = truths[record["recording"]]
        assert record["barrier_eV"] == pytest.approx(truth["barrier_eV"], rel=0.08)
        assert record["naive_gain"] < 0.9 * truth["gain_nepers_per_V"]
        assert "minus the controller's inverse" in record["naive_reason"]


def test_mains_drift_and_resolution_limit_are_stated(junction, truths):
    for record in junction["loop_plant"]["records"]:
        truth, unrest = truths[record["recording"]], record["unrest"]
        hum = {round(line["frequency_Hz"]): line["amplitude_m"] for line in unrest["mains"]}
        assert hum[round(truth["mains_Hz"])] == pytest.approx(truth["mains_gap_m"], rel=0.15)
        low, high = unrest["drift_interval_m_per_s"]
        walk = 2.0 * truth["wander_m_per_root_s"] / math.sqrt(2.1)  # mean rate of the random walk
        assert low - walk < truth["drift_m_per_s"] < high + walk
        step_m = truth["drive_range_V"] / 2**15 * truth["drive_gain_m_per_V"] / math.sqrt(12)
        sources = {source["name"]: source["rms_m"] for source in unrest["sources"]}
        assert sources["drive_step"] == pytest.approx(step_m, rel=0.01)
        assert unrest["limiting_electronics"] == "drive_step"


def test_sweeps_and_loop_agree_and_give_one_barrier(junction):
    joint = junction["joint"]
    assert joint["agree"]
    low, high = joint["ratio_interval"]
    assert low < 1.0 < high
    sweep, loop = junction["gap_law"]["barrier_eV"], junction["loop_plant"]["barrier_eV"]
    low, high = joint["barrier_interval_eV"]
    assert low < sweep < high  # far more accurate than the mean of three spots
    assert abs(loop - joint["barrier_eV"]) < 0.15 * joint["barrier_eV"]


def test_a_wrong_declared_extension_makes_sweeps_and_loop_disagree(simulated, tmp_path):
    """Declared a fifth too small, it raises the barrier of the loop to 1.44 times the other one.

    The guards of the controller, which also depend on metres, decide whether it ships.
    """
    folder = tmp_path / "recordings"
    shutil.copytree(simulated / "recordings", folder)
    lab = (folder / "lab.toml").read_text()
    (line,) = re.findall(r"gain_m_per_V = \S+", lab)
    (folder / "lab.toml").write_text(
        lab.replace(line, f"gain_m_per_V = {float(line.split()[-1]) / 1.2:g}")
    )
    files = [folder / "loop_1.csv", folder / "spectroscopy.dat"]
    status, output = run("fit", *files, "--lab", folder / "lab.toml", "--out", tmp_path / "fit")
    assert status in (0, 1), output
    assert "Sweeps and loop disagree" in output
    tunnelling = json.loads((tmp_path / "fit" / "model.json").read_bytes())["tunnelling"]
    assert tunnelling["joint"]["barrier_eV"] is None
    low, high = tunnelling["joint"]["barrier_interval_eV"]
    assert (
        low < tunnelling["gap_law"]["barrier_eV"] < tunnelling["loop_plant"]["barrier_eV"] < high
    )


def test_model_and_report_contain_the_loop_and_the_naive_estimate(fitted):
    folder, output = fitted
    content = (folder / "model.json").read_bytes()
    assert write_model(read_model(content)) == content
    page = (folder / "report.html").read_text()
    assert 'id="tunnelling"' in page
    assert "naive barrier" in page
    assert "Closed loop: apparent barrier" in output


def test_inspection_classifies_the_dither_as_a_reference(simulated):
    folder = simulated / "recordings"
    (inspection,) = inspect_files([folder / "loop_1.csv"], read_lab(folder / "lab.toml"))
    assert inspection.refusal is None
    assert [column.meaning for column in inspection.columns][3] == "reference of z"
    assert not [problem for problem in inspection.statements if problem.quantity == "incomplete"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("set_point_A = 1e-09\n", "", r"lacks \[tunnelling\] set_point_A"),
        (
            "set_point_A = 1e-09",
            "set_point_A = 5e-09",
            "the median current of loop_1.csv is 9.99e-10",
        ),
        ("floor_A = 1e-12", "floor_A = 0", "floor_A is 0"),
        ("set_point_A = 1e-09", "set_point_A = 0", "set_point_A is zero"),
        ("gain_m_per_V = 1.2e-09", "gain_m_per_V = -1.2e-09", "positive where it extends the tip"),
        ("sampling_rate_Hz = 20000", "sampling_rate_Hz = 40000", "every tick of the loop"),
        ("[axis.z.actuator]\ngain_m_per_V = 1.2e-09\n", "", r"\[axis.z.actuator\] gain_m_per_V"),
        ("floor_A = 1e-12", "floor_A = 1e-12\nextension_uncertainty = 5", "from 0 to below 1"),
        ("reference = 4", "reference = 9", "no column 9"),
        ("reference = 4", "dither = 4", "reference"),
    ],
)
def test_a_missing_or_wrong_entry_of_lab_toml_is_refused_with_its_correction(
    simulated, tmp_path, old, new, message
):
    text = (simulated / "recordings" / "lab.toml").read_text()
    assert old in text
    lab = tmp_path / "lab.toml"
    lab.write_text(text.replace(old, new))
    for recording in (simulated / "recordings").glob("loop_*.csv"):
        (tmp_path / recording.name).touch()  # files that lab.toml describes
    with pytest.raises(LabFileError, match=message):
        _read(simulated / "recordings" / "loop_1.csv", read_lab(lab))


def test_a_short_recording_of_a_tip_is_a_usage_error(tmp_path):
    status, output = run("simulate", "--out", tmp_path / "out", "--junction", "0.5")
    assert status == 2
    assert "too short" in output


def _read(path: Path, lab: Lab):
    return loops_of([collect([path], lab)[0]], lab)
