"""`piezoid inspect` on the terminal and as JSON."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.journeys.command import run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    time_s = np.arange(2000) / 1000
    drive = 50 * np.abs((time_s * 4) % 2 - 1)
    rows = np.column_stack([time_s, drive, 0.2 * drive])
    rows = np.delete(rows, [900], axis=0)
    lines = [f"{t:.3f},{u:.4f},{d:.5f},0" for t, u, d in rows]
    heading = "time [s],voltage [V],pos[red] [um],spare\n"
    (tmp_path / "good.csv").write_text(heading + "\n".join(lines) + "\n")
    (tmp_path / "scope.csv").write_text("X,CH1,CH2\n" + "\n".join(f"{k},1,2" for k in range(9)))
    return tmp_path


def test_the_output_states_channels_clock_and_problems(folder):
    status, output = run("inspect", folder / "good.csv")
    assert status == 0
    for words in (
        "good.csv: text table, 1999 rows",
        "voltage of x",
        "displacement of x",
        "1000 Hz",
        "gap (line 902)",
        "dead",
        "7 reversals",
        "pos[red] [um]",
    ):
        assert words in output


def test_a_refused_file_does_not_hide_the_others(folder):
    status, output = run(
        "inspect", folder / "missing.csv", folder / "scope.csv", folder / "good.csv"
    )
    assert status == 3
    assert "No such file" in output
    assert 'file = "scope.csv"' in output
    assert "good.csv: text table" in output


def test_a_very_long_name_is_truncated(folder):
    np.savez(folder / "long.npz", **{"n" * 60_000: np.arange(9.0), "m" * 60_000: np.arange(3.0)})
    status, output = run("inspect", folder / "long.npz")
    assert status == 3
    assert len(output) < 20_000


def test_lab_toml_completes_a_refused_file(folder):
    lab = folder / "lab.toml"
    lab.write_text(
        '[[recording]]\nfile = "scope.csv"\nsampling_rate_Hz = 10\n'
        'columns = { voltage = "CH1", displacement = "CH2" }\nunits = { displacement = "um" }\n'
    )
    status, output = run("inspect", folder / "scope.csv", "--lab", lab)
    assert status == 0
    assert "axis x, 10 Hz" in output


def test_json_contains_the_inspection(folder):
    status, text = run("inspect", "--json", folder / "good.csv", folder / "scope.csv")
    assert status == 3
    content = json.loads(text)
    assert content["schema"] == "piezoid.inspection/1"
    complete, scope = content["files"]
    assert complete["sampling_rate_Hz"] == 1000
    assert complete["breaks"] == 0
    assert next((p["kind"], "bridged" in p["text"]) for p in complete["problems"]) == ("gap", True)
    assert [column["si_unit"] for column in complete["columns"]] == ["s", "V", "m", ""]
    assert complete["refusal"] is None
    assert "lab.toml" in scope["refusal"]
