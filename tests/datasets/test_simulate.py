"""`piezoid simulate` writes recordings and lab.toml, and the truth in another folder."""

import json
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid_cli.simulate import simulate

app = typer.Typer()
app.command()(simulate)


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(arguments), env={"COLUMNS": "300"})
    return result.exit_code, result.output


@pytest.fixture
def campaign_folder(tmp_path: Path) -> Path:
    out = tmp_path / "virtual"
    code, _ = run("--out", str(out), "--seed", "7", "--effect", "cross_coupling=0.6")
    assert code == 0
    return out


def test_the_recordings_are_readable_and_do_not_reveal_the_truth(campaign_folder):
    folder = campaign_folder / "recordings"
    lab = read_lab(folder / "lab.toml")
    recordings = collect(sorted(folder.glob("*.csv")), lab).recordings
    assert len(recordings) >= 3
    assert all(recording.axis == "x" and not recording.breaks for recording in recordings)
    words = "".join(path.name for path in folder.iterdir()) + (folder / "lab.toml").read_text()
    assert "coupling" not in words
    assert "truth" not in words


def test_the_truth_names_the_effect_and_its_size(campaign_folder):
    truth = json.loads((campaign_folder / "truth" / "truth.json").read_text())
    assert truth["schema"] == "piezoid.truth/1"
    (effect,) = truth["effects"]
    assert effect["effect"] == "cross_coupling"
    assert effect["asked_percent"] == 0.6
    assert abs(effect["measured_percent"] - 0.6) < 0.1
    assert set(truth["recordings"]) == {
        p.stem for p in (campaign_folder / "recordings").glob("*.csv")
    }


def test_the_lab_file_declares_the_healthy_rig(campaign_folder):
    lab = tomllib.loads((campaign_folder / "recordings" / "lab.toml").read_text())
    assert lab["amplifier"]["bandwidth_Hz"] == 4000.0
    assert lab["acquisition"]["input_range_V"] == [-10.0, 10.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--effect", "crep"), "known are amplifier_saturation"),
        (("--effect", "creep=big"), "'big' is not a number"),
        (("--truth", "play"), "known are bouc_wen"),
        (("--recording", "sweeep"), "known are check"),
        (("--effect", "cross_coupling", "--recording", "sweep"), "no other axis is driven"),
    ],
)
def test_an_unknown_word_is_a_usage_error_with_the_known_words(arguments, message, tmp_path):
    code, output = run("--out", str(tmp_path / "out"), *arguments)
    assert code == 2
    assert message in " ".join(output.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_foreign_files_are_kept_and_results_replaced_with_force_only(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    arguments = ("--recording", "check")
    for words in (arguments, (*arguments, "--force")):
        assert run("--out", str(tmp_path), *words)[0] != 0
        assert (tmp_path / "mine.txt").read_text() == "mine"
    results = str(tmp_path / "made")
    assert run("--out", results, *arguments)[0] == 0
    assert run("--out", results, *arguments)[0] != 0
    assert run("--out", results, *arguments, "--force")[0] == 0
