"""A disk that is full or read only: one message, status 3, and what was there is still there."""

import ast
import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest

import piezoid_cli
from piezoid.identification.store import write_model
from piezoid_cli import calibration
from piezoid_cli.main import main
from piezoid_cli.results_place import results_place
from piezoid_datasets.virtual_lab import junction_campaign
from tests.reports.known_stage import axis_model, stage_model

ROWS = "".join(f"{k / 100},{k % 9},{2 * (k % 9)}\n" for k in range(60))
WRITERS = ("write_bytes", "write_text", "mkdir", "touch", "rename", "replace", "unlink")


def fails(number: int) -> Callable[..., NoReturn]:
    def system(*_: Any, **__: Any) -> NoReturn:
        raise OSError(number, os.strerror(number), "a name nobody has heard of")

    return system


def opens_nothing_new(number: int) -> Callable[..., Any]:
    original = Path.open

    def opened(path: Path, mode: str = "r", *rest: Any, **named: Any) -> Any:
        return fails(number)() if "x" in mode else original(path, mode, *rest, **named)

    return opened


FAULTS = {
    "full while writing": (os, "fsync", errno.ENOSPC, "No space left"),
    "full before": (os, "mkdir", errno.ENOSPC, "No space left"),
    "read only": (os, "mkdir", errno.EROFS, "Read-only"),
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording, a stage, results of before; what takes long is done already."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    done = SimpleNamespace(files={"model.json": b"new", "bundle/a.h": b"new"}, passed=True)
    monkeypatch.setattr(calibration, "calibrate", lambda *_: done)
    monkeypatch.setattr(junction_campaign, "draw_junction_campaign", lambda *_, **__: None)
    monkeypatch.setattr(junction_campaign, "junction_files", lambda _: dict(done.files))
    for folder in ("made", "stage", "night/unit"):
        Path(folder).mkdir(parents=True)
    Path("s.csv").write_text("time [s],voltage [V],position [um]\n" + ROWS)
    Path("made/kept.txt").write_text("what was there")
    Path("stage/model.json").write_bytes(write_model(stage_model(axis_model())))
    return tmp_path


def held(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("fit s.csv --out made --force", "made: "),
        ("simulate --junction 2 --out made --force", "made: "),
        ("report stage", "stage: "),
        ("init s.csv --out made/lab.toml", "made/lab.toml: "),
    ],
)
def test_a_verb_that_cannot_write_says_so_once_and_leaves_what_was_there(
    words: str,
    told: str,
    fault: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = held(place)
    module, name, number, reason = FAULTS[fault]
    if words.startswith("init") and name == "mkdir":  # one file: it is the file that fails
        monkeypatch.setattr(Path, "open", opens_nothing_new(number))
    else:
        monkeypatch.setattr(module, name, fails(number))
    monkeypatch.setattr(sys, "argv", ["piezoid", *words.split(), "--quiet"])
    with pytest.raises(SystemExit) as ended:
        main()
    said = " ".join(capsys.readouterr().err.split())
    assert ended.value.code == 3
    assert said.startswith(f"error: {told}{reason}")
    assert said.count("error:") == 1
    assert "nobody" not in said
    assert held(place) == before
    assert not list(place.rglob("*.unfinished"))


def test_a_batch_whose_disk_is_full_keeps_no_half_of_a_stage(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", fails(errno.ENOSPC))
    results = results_place(str(place / "results"))
    with pytest.raises(OSError, match="No space"):
        results.write("unit", {"model.json": b"new", "batch.json": b"{}"})
    with pytest.raises(OSError, match="No space"):
        results.put("parameters.parquet", lambda stream: stream.write(b"new"))
    assert not held(place / "results")


def test_no_verb_writes_past_the_folder_that_appears_whole() -> None:
    """What is proven of `output_folder` holds for every verb, those of tomorrow as well."""
    for path in Path(piezoid_cli.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if path.name == "output_folder.py" or not isinstance(node, ast.Call):
                continue
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            where = f"{path.name}:{node.lineno}"
            assert called not in WRITERS or _of_text(node), where
            assert name != "open", where


def _of_text(node: ast.Call) -> bool:
    """Tell whether ``replace`` is that of a text or of a record, which take other arguments."""
    return ast.unparse(node.func).endswith(".replace") and len(node.args) == 2
