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
from piezoid_cli.interrupt import install, interruptible
from pathlib import Path
install()
with interruptible():
    print("working", flush=True)
    n = 0
    while True:
        n += 1
        files = {f"{i}.bin": b"%d" % n * 20000 for i in range(8)}
        folder.write_folder(Path("stage"), files, force=True)
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


def test_an_interrupted_fit_leaves_what_was_there(tmp_path):
    write_folder(tmp_path / "stage", {"model.json": b"precious"})
    before = sorted(p.name for p in (tmp_path / "stage").iterdir())
    sweep = piezoid_datasets.recordings()[0]
    status = interrupted(FIT, tmp_path, 0.5, "fit", sweep, "--out", "stage", "--force")
    assert status == 130
    assert [p.name for p in tmp_path.iterdir()] == ["stage"]
    assert sorted(p.name for p in (tmp_path / "stage").iterdir()) == before
    assert (tmp_path / "stage" / "model.json").read_text() == "precious"


@pytest.mark.parametrize("after_s", [0.0, 0.05])
def test_interrupted_while_writing_the_folder_is_whole_and_alone(tmp_path, after_s):
    assert interrupted(WRITE, tmp_path, after_s) == 130
    assert {p.name for p in tmp_path.iterdir()} <= {"stage"}
    held = [p.read_bytes() for p in (tmp_path / "stage").glob("*.bin")]
    assert len(held) in (0, 8)
    assert len(set(held)) <= 1


def test_interrupted_while_modules_load_the_status_is_130_and_the_message_one_line(tmp_path):
    """From the first instruction of the command on; before, Python itself is starting."""
    code = (
        "import piezoid_cli.interrupt; print('begun', flush=True); "
        "from piezoid_cli.__main__ import main; main()"
    )
    words = ["simulate", "--recording", "sweep", "--out", "stage", "--quiet"]
    statuses = []
    for k in range(8):
        process = subprocess.Popen(
            [sys.executable, "-c", code, *words],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.02 + 0.2 * k)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        statuses.append(process.returncode)
        if process.returncode != 130:  # it had come to its end
            assert (process.returncode, said) == (0, b"")
            break
        assert said == b"interrupted: no file is left half written\n"
        assert not list(tmp_path.iterdir())
    assert len(statuses) > 2


def test_an_interruption_that_a_library_swallows_still_ends_the_command(tmp_path):
    code = """
import signal, time
from piezoid_cli.interrupt import install, interruptible
install()
with interruptible():
    try:
        print("working", flush=True)
        time.sleep(60)
    except BaseException:
        pass
    try:
        time.sleep(60)
    except BaseException as error:
        raise ImportError("cannot load") from None
"""
    assert interrupted(code, tmp_path, 0.1) == 130


def test_an_interruption_after_the_end_of_the_work_changes_nothing(tmp_path):
    """While Python unloads its modules the command is done already."""
    code = """
import time
from piezoid_cli.interrupt import install, interruptible
install()
class Late:
    def __del__(self, sleep=time.sleep, show=print):
        show("working", flush=True)
        sleep(0.5)
with interruptible():
    late = Late()
"""
    assert interrupted(code, tmp_path, 0.1) == 0
