"""On a full or read-only disk a verb prints one message, exits with 3 and keeps existing files."""

import ast
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import piezoid_cli
from piezoid.identification.store import write_model
from piezoid.manifest import MANIFEST
from piezoid.output_folder import write_folder
from piezoid_cli.result_store import result_store
from tests.reports.known_stage import axis_model, stage_model

ROWS = "".join(f"{k / 100},{k % 9},{2 * (k % 9)}\n" for k in range(60))
WRITERS = ("write_bytes", "write_text", "mkdir", "touch", "rename", "replace", "unlink")
ROOM_FOR_100_BYTES = """
from resource import RLIMIT_FSIZE, getrlimit, setrlimit
setrlimit(RLIMIT_FSIZE, (100, getrlimit(RLIMIT_FSIZE)[1]))
"""
# Root may write anywhere, so the process drops CAP_DAC_OVERRIDE by PR_CAPBSET_DROP.
NO_RIGHTS_OF_ROOT = """
import ctypes, os
os.geteuid() or ctypes.CDLL(None).prctl(24, 1)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Write a recording, a stage, and earlier results."""
    for subfolder in ("stage", "night/unit"):
        (tmp_path / subfolder).mkdir(parents=True)
    write_folder(tmp_path / "made", {"kept.txt": b"what was there"})
    (tmp_path / "s.csv").write_text("time [s],voltage [V],position [um]\n" + ROWS)
    (tmp_path / "stage/model.json").write_bytes(write_model(stage_model(axis_model())))
    yield tmp_path
    for subfolder in (tmp_path, tmp_path / "made"):
        subfolder.chmod(0o755)


def contents_of(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def exit_of(words: str, folder: Path, prepare: str) -> tuple[int, str]:
    """Return exit status and error message of a command.

    prepare  statements that its process executes first
    """
    command = ["-m", "piezoid_cli.main", *words.split(), "--quiet"]
    launcher = (
        f"{prepare}\nimport os, sys\nos.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    )
    result = subprocess.run(
        [sys.executable, "-c", launcher, *command],
        cwd=folder,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    return result.returncode, " ".join(result.stderr.split())


SIMULATE = "simulate --recording sweep --out made --force"
VERBS = {
    "fit s.csv --out made --force": "made",
    SIMULATE: "made",
    "report stage": "stage",
    "init s.csv --out made/lab.toml": "made/lab.toml",
}


# The other verbs write like these two: test_every_verb_writes_through_the_output_folder.
@pytest.mark.parametrize("words", ["report stage", "init s.csv --out made/lab.toml", SIMULATE])
def test_a_verb_on_a_full_disk_prints_one_message_and_keeps_existing_files(words, folder):
    original = contents_of(folder)
    status, message = exit_of(words, folder, ROOM_FOR_100_BYTES)
    assert message.startswith(f"error: {VERBS[words]}: File too large")
    assert status == 3
    assert message.count("error:") == 1
    assert "unfinished" not in message
    assert contents_of(folder) == original
    assert not list(folder.rglob("*.unfinished"))


@pytest.mark.parametrize("words", VERBS)
def test_a_verb_without_write_permission_prints_one_message_before_its_work(words, folder):
    original = contents_of(folder)
    for subfolder in (folder / "made", folder):
        subfolder.chmod(0o555)
    status, message = exit_of(words, folder, NO_RIGHTS_OF_ROOT)
    name = VERBS[words] if words.startswith("init") else str(folder)
    assert message.startswith(f"error: {name}: Permission denied")
    assert status == 3
    assert message.count("error:") == 1
    assert contents_of(folder) == original


def test_a_batch_on_a_full_disk_writes_no_incomplete_stage(folder):
    results = result_store(str(folder / "results"))
    results.create()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            results.write_stage("unit", {"batch.json": b"{}", "model.json": bytes(2000)})
        with pytest.raises(OSError, match="too large"):
            results.write_file("parameters.parquet", lambda stream: stream.write(bytes(2000)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert {Path(name).name for name in contents_of(folder / "results")} == {MANIFEST}


def test_every_verb_writes_through_the_output_folder():
    """The guarantees of `piezoid.output_folder` hold for every verb."""
    for path in Path(piezoid_cli.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            method = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            location = f"{path.name}:{node.lineno}"
            assert method not in WRITERS or _of_text(node), location
            assert name != "open", location


def _of_text(node: ast.Call) -> bool:
    """Return whether ``replace`` belongs to a text or a record, with two arguments."""
    return ast.unparse(node.func).endswith(".replace") and len(node.args) == 2
