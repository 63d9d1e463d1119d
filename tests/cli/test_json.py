"""Output of the verbs for scripts: --json prints a document with a schema, --quiet nothing."""

import json

import pytest

from piezoid_cli.main import VERBS
from piezoid_datasets import LAB
from tests.cli.calls import invoke

CHECK = LAB.parent / "x_check.csv"


@pytest.mark.parametrize("verb", [verb.__name__ for verb in VERBS])
def test_every_verb_has_json_and_quiet_and_no_negated_switch(verb):
    help_text = invoke(verb, "--help").output
    assert "--json" in help_text
    assert "--quiet" in help_text
    assert "--no-" not in help_text


def test_a_simulation_lists_its_files(tmp_path):
    words = ("simulate", "--out", tmp_path / "made", "--seed", 3)
    document = json.loads(invoke(*words, "--json").output)
    assert document["schema"] == "piezoid.simulated/1"
    assert document["seed"] == 3
    assert all((tmp_path / "made" / name).is_file() for name in document["files"])
    assert invoke(*words, "--force", "--quiet").output == ""


def test_a_draft_names_incomplete_entries(tmp_path):
    incomplete = tmp_path / "run.csv"
    incomplete.write_text("a,b\n1,2\n2,3\n")
    path = tmp_path / "lab.toml"
    result = invoke("init", CHECK, incomplete, "--out", path, "--json")
    assert result.exit_code == 3
    assert json.loads(result.stdout) == {
        "schema": "piezoid.drafted/1",
        "file": str(path),
        "incomplete": ["run.csv"],
    }


def test_a_quiet_inspection_prints_only_refusals(tmp_path):
    empty = tmp_path / "empty.csv"
    empty.write_bytes(b"")
    result = invoke("inspect", CHECK, "--quiet")
    assert (result.exit_code, result.output) == (0, "")
    refused = invoke("inspect", CHECK, empty, "--quiet")
    assert (refused.exit_code, refused.stdout) == (3, "")
    assert "empty.csv: the file is empty. Needed: a table of numbers." in refused.stderr
