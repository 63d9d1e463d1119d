"""After Ctrl-C the folder is unchanged, no temporary files remain, and the status is 130."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import piezoid_datasets
from piezoid.output_folder import write_folder

# Starts the work of the verb, prints a line, and waits for the interruption.
FIT = """
import sys
import piezoid_cli.calibration as calibration
from piezoid_cli.main import main

def calibrate(*arguments):
    print("working", flush=True)
    return original(*arguments)

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


def exit_status_after_interrupt(
    code: str, folder: Path, after_s: float, *arguments: str | Path
) -> int:
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout.readline() == b"working\n"
    time.sleep(after_s)
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=60)
    assert b"Traceback" not in message
    return process.returncode


def test_an_interrupted_fit_keeps_the_previous_results(tmp_path):
    write_folder(tmp_path / "stage", {"model.json": b"precious"})
    original = sorted(p.name for p in (tmp_path / "stage").iterdir())
    sweep = piezoid_datasets.recordings()[0]
    status = exit_status_after_interrupt(
        FIT, tmp_path, 0.5, "fit", sweep, "--out", "stage", "--force"
    )
    assert status == 130
    assert [p.name for p in tmp_path.iterdir()] == ["stage"]
    assert sorted(p.name for p in (tmp_path / "stage").iterdir()) == original
    assert (tmp_path / "stage" / "model.json").read_text() == "precious"


@pytest.mark.parametrize("after_s", [0.0, 0.05])
def test_an_interrupted_write_leaves_complete_files(tmp_path, after_s):
    assert exit_status_after_interrupt(WRITE, tmp_path, after_s) == 130
    assert {p.name for p in tmp_path.iterdir()} <= {"stage"}
    contents = [p.read_bytes() for p in (tmp_path / "stage").glob("*.bin")]
    assert len(contents) in (0, 8)
    assert len(set(contents)) <= 1


def test_an_interruption_during_imports_gives_status_130_and_one_line(tmp_path):
    """From the first instruction of the command on; earlier, Python itself is starting."""
    code = (
        "import piezoid_cli.interrupt; print('begun', flush=True); "
        "from piezoid_cli.__main__ import main; main()"
    )
    words = ["simulate", "--recording", "sweep", "--out", "stage", "--quiet"]
    statuses = []
    for after_s in (0.02, 0.2, 0.5, 0.9):
        process = subprocess.Popen(
            [sys.executable, "-c", code, *words],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        process.stdout.readline()
        time.sleep(after_s)
        process.send_signal(signal.SIGINT)
        _, message = process.communicate(timeout=60)
        statuses.append(process.returncode)
        if process.returncode != 130:  # completed before the interruption
            assert (process.returncode, message) == (0, b"")
            break
        assert message == b"interrupted: no file is left half written\n"
        assert not list(tmp_path.iterdir())
    assert len(statuses) > 2


def test_an_interruption_caught_by_a_library_still_ends_the_command(tmp_path):
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
    assert exit_status_after_interrupt(code, tmp_path, 0.1) == 130


def test_an_interruption_after_the_work_has_no_effect(tmp_path):
    """The command is complete while Python unloads its modules."""
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
    assert exit_status_after_interrupt(code, tmp_path, 0.1) == 0
