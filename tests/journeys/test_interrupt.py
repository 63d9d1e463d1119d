"""Ctrl-C: the folder is what it was before, nothing lies beside it, and the status says so."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import piezoid_datasets
from piezoid.output_folder import write_folder

# Begins the verb's work, and says so, before it waits to be interrupted.
FIT = """
import sys
import piezoid_cli.calibration as calibration
from piezoid_cli.main import main

def calibrate(*given):
    print("working", flush=True)
    return original(*given)

original, calibration.calibrate = calibration.calibrate, calibrate
main()
"""
WRITE = """
import sys
import piezoid.output_folder as folder
from piezoid_cli.main import _interrupt, Interrupted
from pathlib import Path
import signal
signal.signal(signal.SIGINT, _interrupt)
try:
    print("working", flush=True)
    n = 0
    while True:
        n += 1
        files = {f"{i}.bin": b"%d" % n * 20000 for i in range(8)}
        folder.write_folder(Path("stage"), files, force=True)
except Interrupted:
    sys.exit(130)
"""


def interrupted(code: str, place: Path, after_s: float, *arguments: str | Path) -> int:
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=place,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"working\n"
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert b"Traceback" not in said
    return process.returncode


@pytest.mark.parametrize("after_s", [0.1, 1.5])
def test_an_interrupted_fit_leaves_what_was_there(tmp_path: Path, after_s: float) -> None:
    write_folder(tmp_path / "stage", {"model.json": b"precious"})
    before = sorted(p.name for p in (tmp_path / "stage").iterdir())
    sweep = piezoid_datasets.recordings()[0]
    status = interrupted(FIT, tmp_path, after_s, "fit", sweep, "--out", "stage", "--force")
    assert status == 130
    assert [p.name for p in tmp_path.iterdir()] == ["stage"]
    assert sorted(p.name for p in (tmp_path / "stage").iterdir()) == before
    assert (tmp_path / "stage" / "model.json").read_text() == "precious"


@pytest.mark.parametrize("after_s", [0.0, 0.017, 0.05])
def test_interrupted_while_writing_the_folder_is_whole_and_alone(
    tmp_path: Path, after_s: float
) -> None:
    assert interrupted(WRITE, tmp_path, after_s) == 130
    assert {p.name for p in tmp_path.iterdir()} <= {"stage"}
    held = [p.read_bytes() for p in (tmp_path / "stage").glob("*.bin")]
    assert len(held) in (0, 8)
    assert len(set(held)) <= 1
