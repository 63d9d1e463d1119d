"""Every verb that writes keeps a user's files: in a home, a repository, and foreign folders."""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.errors import PiezoidError
from piezoid.manifest import MANIFEST
from piezoid.output_folder import add_to_folder, write_folder
from piezoid.sealed_files import write_model
from piezoid_cli.main import app
from tests.foreign_objects import KINDS, look, plant
from tests.reports.known_diagnosis import diagnosed
from tests.reports.known_stage import axis_model, stage_model

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")

DRIVE = [min(k % 80, 80 - k % 80) / 4 for k in range(320)]
ROWS = "".join(f"{k / 100},{u},{2 * u + 0.03 * u * u}\n" for k, u in enumerate(DRIVE))
# A butterfly, to which no model applies; a worker fits it quickly, although it tries every order.
BUTTERFLY = "".join(f"{k / 100},{u},{0.1 * (u - 5) ** 2}\n" for k, u in enumerate(DRIVE[:160]))
STAGE = {
    "model.json": write_model(stage_model(axis_model())),
    "diagnosis.json": write_diagnosis(diagnosed()),
}
# Verbs and the folders that they write. Other verbs: tests/verification/test_stage_verbs.py.
VERBS = {
    "fit s.csv --out made --force": "made",
    "diagnose s.csv --out made --force": "made",
    "simulate --recording sweep --out made --force": "made",
    "plan stage --rate 1000 --out made --force": "made",
    "learn stage --reference r.csv --out made --force": "made",
    "plan stage --rate 1000 --force": "stage",
    "report stage --force": "stage",
    "batch night --out made --force --workers 1": "made",
}


def write_recording(path: Path, rows: str = ROWS) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("time [s],voltage [V],position [um]\n" + rows)


@pytest.fixture
def work_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working directory, in a simulated home."""
    home = tmp_path / "home"
    write_recording(home / "work/s.csv")
    write_recording(home / "work/night/st1/s.csv", BUTTERFLY)
    (home / "work/night/st1/lab.toml").write_text('[rig]\nname = "st1"\n')
    (home / "work/r.csv").write_text("x [um]\n" + "".join(f"{u}\n" for u in DRIVE[:160]))
    write_folder(home / "work/stage", STAGE)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(home / "work")
    return home / "work"


def piezoid(words: str) -> Result:
    result = CliRunner().invoke(app, words.split())
    assert result.exception is None or isinstance(result.exception, SystemExit | PiezoidError), (
        result
    )
    return result


# Learning requires a shipped stage: tests/cli/test_learn.py.
@pytest.mark.parametrize("words", [words for words in VERBS if not words.startswith("learn")])
def test_a_verb_keeps_foreign_objects_of_all_kinds_in_its_folder(words, work_folder):
    folder = work_folder / VERBS[words]
    add_to_folder(folder, {"old.json": b"ours"})
    for sub in ("", "bundle", "mine"):
        for kind in KINDS:
            plant(kind, folder / sub / kind, work_folder / "beyond")
    foreign_paths = [folder / sub / kind for sub in ("", "bundle", "mine") for kind in KINDS]
    original = [look(path) for path in (*foreign_paths, work_folder / "beyond")]
    manifest = (folder / MANIFEST).read_bytes()
    result = piezoid(words)
    assert (folder / MANIFEST).read_bytes() != manifest, (result.output, result.exception)
    assert [look(path) for path in (*foreign_paths, work_folder / "beyond")] == original
    is_added_to = VERBS[words] == "stage" or words.startswith("batch")
    assert (folder / "old.json").exists() == is_added_to


@pytest.mark.parametrize("words", [words for words in VERBS if VERBS[words] == "made"])
def test_a_verb_refuses_a_home_a_repository_and_a_foreign_folder_with_force(words, work_folder):
    (work_folder / "code/.git").mkdir(parents=True)
    (work_folder / "others").mkdir()
    (work_folder / "others/thesis.tex").write_text("precious")
    (work_folder / "link").symlink_to(work_folder / "others")
    (work_folder.parent / ".ssh").mkdir(mode=0o700)
    (work_folder.parent / ".ssh/id").write_text("precious")
    original = look(work_folder.parent)
    for out in (str(work_folder.parent), "code", "others", "link", ".", ".."):
        result = piezoid(words.replace("--out made", f"--out {out}"))
        assert result.exit_code == 2, (out, result.stderr)
    assert look(work_folder.parent) == original


def test_a_verb_refuses_an_edited_file_and_replaces_it_with_force(work_folder):
    assert piezoid("report stage --quiet").exit_code == 0
    page = work_folder / "stage/report.html"
    page.write_text("my notes")
    result = piezoid("report stage")
    assert result.exit_code == 2
    assert "--force" in result.stderr
    assert page.read_text() == "my notes"
    assert piezoid("report stage --quiet --force").exit_code == 0
    assert "my notes" not in page.read_text()


@pytest.mark.parametrize(
    "words",
    [
        "plan stage --rate 1000 --out stage --force",
        "learn stage --reference r.csv --out stage --force",
        "diagnose stage/model.json s.csv --out stage --force",
        "diagnose s.csv --lab stage/lab.toml --out stage --force",
        "plan stage --rate 1000 --out . --force",
    ],
)
def test_a_verb_does_not_replace_its_input_folder(words, work_folder):
    original = look(work_folder)
    assert piezoid(words).exit_code == 2
    assert look(work_folder) == original


@pytest.mark.parametrize("linked", ["", "o", "o/stages", "o/stages/st1"])
def test_a_batch_keeps_foreign_files_in_its_result_folder(linked, work_folder):
    """The folder may be a symbolic link, with and without ``--force``."""
    foreign_folder = work_folder / "theirs/stages/st1"
    foreign_folder.mkdir(parents=True)
    (foreign_folder / "keep.txt").write_text("x")
    if linked:
        (work_folder / linked).parent.mkdir(parents=True, exist_ok=True)
        (work_folder / linked).symlink_to(work_folder / "theirs" / linked[2:])
    else:
        (work_folder / "theirs").rename(work_folder / "o")
    original = look(work_folder)
    for force in ("", "--force"):
        result = piezoid(f"batch night --out o --workers 1 {force}")
        assert result.exit_code == 2, result.stderr
    assert look(work_folder) == original


def test_the_report_omits_a_foreign_diagnosis(work_folder):
    assert "left out" not in piezoid("report stage").output
    another_diagnosis = replace(diagnosed(), explained_fraction=0.5)
    (work_folder / "stage/diagnosis.json").write_bytes(write_diagnosis(another_diagnosis))
    assert "out of date: diagnosis.json" in piezoid("report stage").output
