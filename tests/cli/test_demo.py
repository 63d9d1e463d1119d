"""`piezoid demo` and `--version` from any folder; the gate runs the complete demo."""

import os

import piezoid
from tests.cli.calls import run_module


def test_the_version_is_that_of_the_package(tmp_path):
    result = run_module(tmp_path, "--version")
    assert (result.returncode, result.stdout) == (0, f"piezoid {piezoid.__version__}\n")


def test_the_demo_keeps_what_a_folder_holds(tmp_path):
    (tmp_path / "piezoid-demo").mkdir()
    (tmp_path / "piezoid-demo" / "notes.txt").write_text("mine")
    result = run_module(tmp_path, "demo")
    assert result.returncode == 2
    assert "--force" in result.stderr
    assert os.listdir(tmp_path / "piezoid-demo") == ["notes.txt"]
