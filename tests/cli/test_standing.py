"""Whoever stands in the folder that a verb replaces is told so, and may go on."""

import subprocess
import sys
from pathlib import Path

import pytest

REPLACE = """
from pathlib import Path
from piezoid_cli.output_folder import add_to_folder
from piezoid_cli.main import standing

with standing(quiet={quiet}):
    held = Path("kept.txt").read_text()
    add_to_folder(Path("."), {{"kept.txt": held.encode() + b"+"}})
"""
NOTE = "this folder was replaced by the finished one: `cd .` enters it\n"


def run(folder: Path, script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "-c", script], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("quiet", [False, True])
def test_a_second_verb_of_the_same_line_finds_what_the_first_has_written(
    tmp_path: Path, quiet: bool
) -> None:
    folder = tmp_path / "stage"
    folder.mkdir()
    (folder / "kept.txt").write_text("0")
    (tmp_path / "verb.py").write_text(REPLACE.format(quiet=quiet))
    verb = f"{sys.executable} {tmp_path / 'verb.py'}"
    done = run(tmp_path, f"cd stage && {verb} && {verb} && cd . && cat kept.txt")
    assert (done.returncode, done.stdout) == (0, "0++")
    assert done.stderr == ("" if quiet else 2 * NOTE)


def test_who_stands_elsewhere_is_told_nothing(tmp_path: Path) -> None:
    done = run(tmp_path, f"{sys.executable} -m piezoid_cli.main inspect --help")
    assert NOTE not in done.stderr
