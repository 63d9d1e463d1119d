"""A disk that is full or read only: one message, status 3, and what was there is still there."""

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
# Root may write anywhere; what root starts here may not: PR_CAPBSET_DROP of CAP_DAC_OVERRIDE.
NO_RIGHTS_OF_ROOT = """
import ctypes, os
os.geteuid() or ctypes.CDLL(None).prctl(24, 1)
"""


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Path]:
    """A recording, a stage, and results of before."""
    for folder in ("stage", "night/unit"):
        (tmp_path / folder).mkdir(parents=True)
    write_folder(tmp_path / "made", {"kept.txt": b"what was there"})
    (tmp_path / "s.csv").write_text("time [s],voltage [V],position [um]\n" + ROWS)
    (tmp_path / "stage/model.json").write_bytes(write_model(stage_model(axis_model())))
    yield tmp_path
    for folder in (tmp_path, tmp_path / "made"):
        folder.chmod(0o755)


def held(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def ended(words: str, place: Path, prepare: str) -> tuple[int, str]:
    """Return the status of a command and what it said of its end.

    prepare  what its process does to itself before the command takes its place
    """
    command = ["-m", "piezoid_cli.main", *words.split(), "--quiet"]
    begin = f"{prepare}\nimport os, sys\nos.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    done = subprocess.run(
        [sys.executable, "-c", begin, *command],
        cwd=place,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, " ".join(done.stderr.split())


VERBS = {
    "fit s.csv --out made --force": "made",
    "simulate --recording sweep --out deep/stage --force": "deep/stage",
    "report stage": "stage",
    "init s.csv --out made/lab.toml": "made/lab.toml",
}


@pytest.mark.parametrize("words", VERBS)
def test_a_verb_whose_disk_is_full_says_so_once_and_leaves_what_was_there(words, place):
    before = held(place)
    status, said = ended(words, place, ROOM_FOR_100_BYTES)
    assert said.startswith(f"error: {VERBS[words]}: File too large")
    assert status == 3
    assert said.count("error:") == 1
    assert "unfinished" not in said
    assert held(place) == before
    assert not list(place.rglob("*.unfinished"))


@pytest.mark.parametrize("words", VERBS)
def test_a_verb_that_may_not_write_says_so_once_and_before_the_work(words, place):
    before = held(place)
    for folder in (place / "made", place):
        folder.chmod(0o555)
    status, said = ended(words, place, NO_RIGHTS_OF_ROOT)
    told = VERBS[words] if words.startswith("init") else str(place)
    assert said.startswith(f"error: {told}: Permission denied")
    assert status == 3
    assert said.count("error:") == 1
    assert held(place) == before


def test_a_batch_whose_disk_is_full_keeps_no_half_of_a_stage(place):
    results = result_store(str(place / "results"))
    results.create()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="too large"):
            results.write_stage("unit", {"batch.json": b"{}", "model.json": bytes(2000)})
        with pytest.raises(OSError, match="too large"):
            results.write_file("parameters.parquet", lambda stream: stream.write(bytes(2000)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert {Path(name).name for name in held(place / "results")} == {MANIFEST}


def test_no_verb_writes_past_the_folder_that_appears_whole():
    """What is proven of `piezoid.output_folder` holds for every verb."""
    for path in Path(piezoid_cli.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            where = f"{path.name}:{node.lineno}"
            assert called not in WRITERS or _of_text(node), where
            assert name != "open", where


def _of_text(node: ast.Call) -> bool:
    """Tell whether ``replace`` is that of a text or of a record, which take other arguments."""
    return ast.unparse(node.func).endswith(".replace") and len(node.args) == 2
