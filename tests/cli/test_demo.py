"""`piezoid demo` and `--version` from any folder; the gate runs the demo whole."""

import os
import subprocess
import sys
from pathlib import Path

import piezoid

PIEZOID = (sys.executable, "-m", "piezoid_cli.main")


def run(place: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*PIEZOID, *words], cwd=place, capture_output=True, text=True, check=False
    )


def test_the_version_is_that_of_the_package(tmp_path: Path) -> None:
    done = run(tmp_path, "--version")
    assert (done.returncode, done.stdout) == (0, f"piezoid {piezoid.__version__}\n")


def test_the_demo_keeps_what_a_folder_holds(tmp_path: Path) -> None:
    (tmp_path / "piezoid-demo").mkdir()
    (tmp_path / "piezoid-demo" / "notes.txt").write_text("mine")
    done = run(tmp_path, "demo")
    assert done.returncode == 2
    assert "--force" in done.stderr
    assert os.listdir(tmp_path / "piezoid-demo") == ["notes.txt"]
