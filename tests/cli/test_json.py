"""Every verb speaks to scripts: --json prints one text with a schema, --quiet nothing."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from piezoid_cli.main import VERBS, app
from piezoid_datasets import LAB

FOLDER = LAB.parent
RUNNER = CliRunner()


def options(verb: str) -> str:
    return RUNNER.invoke(app, [verb, "--help"], env={"COLUMNS": "200"}).output


@pytest.mark.parametrize("verb", [verb.__name__ for verb in VERBS])
def test_every_verb_takes_both_and_no_switch_has_a_twin(verb: str) -> None:
    shown = options(verb)
    assert "--json" in shown
    assert "--quiet" in shown
    assert "--no-" not in shown


def test_what_was_simulated_is_handed_over(tmp_path: Path) -> None:
    words = ["simulate", "--out", str(tmp_path / "made"), "--seed", "3"]
    done = RUNNER.invoke(app, [*words, "--json"])
    found = json.loads(done.output)
    assert found["schema"] == "piezoid.simulated/1"
    assert found["seed"] == 3
    assert all((tmp_path / "made" / name).is_file() for name in found["files"])
    assert RUNNER.invoke(app, [*words, "--force", "--quiet"]).output == ""


def test_a_draft_names_what_must_be_completed(tmp_path: Path) -> None:
    doubtful = tmp_path / "run.csv"
    doubtful.write_text("a,b\n1,2\n2,3\n")
    files = [str(FOLDER / "x_check.csv"), str(doubtful)]
    place = tmp_path / "lab.toml"
    done = RUNNER.invoke(app, ["init", *files, "--out", str(place), "--json"])
    assert done.exit_code == 3
    found = json.loads(done.stdout)
    assert found == {"schema": "piezoid.drafted/1", "file": str(place), "incomplete": ["run.csv"]}


def test_a_quiet_inspection_tells_refusals_alone(tmp_path: Path) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_bytes(b"")
    readable = str(FOLDER / "x_check.csv")
    fine = RUNNER.invoke(app, ["inspect", readable, "--quiet"])
    assert (fine.exit_code, fine.output) == (0, "")
    refused = RUNNER.invoke(app, ["inspect", readable, str(empty), "--quiet"])
    assert (refused.exit_code, refused.stdout) == (3, "")
    assert "empty.csv: the file is empty. Needed: a table of numbers." in refused.stderr
