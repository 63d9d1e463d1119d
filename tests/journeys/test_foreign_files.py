"""Nothing of a user's is lost: every verb that writes, in a home, a repository, beside others."""

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
# A butterfly, to which no model applies: soon fitted by a worker, which tries every order.
BUTTERFLY = "".join(f"{k / 100},{u},{0.1 * (u - 5) ** 2}\n" for k, u in enumerate(DRIVE[:160]))
STAGE = {
    "model.json": write_model(stage_model(axis_model())),
    "diagnosis.json": write_diagnosis(diagnosed()),
}
# Verbs, with the folder that they write; others: tests/verification/test_stage_verbs.py.
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


def write_recording(place: Path, rows: str = ROWS) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text("time [s],voltage [V],position [um]\n" + rows)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, in an invented home."""
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
    done = CliRunner().invoke(app, words.split())
    assert done.exception is None or isinstance(done.exception, SystemExit | PiezoidError), done
    return done


# Only what has shipped can be learned of: tests/cli/test_learn.py
@pytest.mark.parametrize("words", [words for words in VERBS if not words.startswith("learn")])
def test_a_verb_leaves_objects_of_all_kinds_in_its_folder_as_they_are(
    words: str, place: Path
) -> None:
    folder = place / VERBS[words]
    add_to_folder(folder, {"old.json": b"ours"})
    for sub in ("", "bundle", "mine"):
        for kind in KINDS:
            plant(kind, folder / sub / kind, place / "beyond")
    others = [folder / sub / kind for sub in ("", "bundle", "mine") for kind in KINDS]
    before = [look(other) for other in (*others, place / "beyond")]
    manifest = (folder / MANIFEST).read_bytes()
    done = piezoid(words)
    assert (folder / MANIFEST).read_bytes() != manifest, (done.output, done.exception)
    assert [look(other) for other in (*others, place / "beyond")] == before
    is_added_to = VERBS[words] == "stage" or words.startswith("batch")
    assert (folder / "old.json").exists() == is_added_to


@pytest.mark.parametrize("words", [words for words in VERBS if VERBS[words] == "made"])
def test_a_verb_refuses_a_home_folder_a_repository_and_a_folder_of_others_with_force(
    words: str, place: Path
) -> None:
    (place / "code/.git").mkdir(parents=True)
    (place / "others").mkdir()
    (place / "others/thesis.tex").write_text("precious")
    (place / "link").symlink_to(place / "others")
    (place.parent / ".ssh").mkdir(mode=0o700)
    (place.parent / ".ssh/id").write_text("precious")
    before = look(place.parent)
    for out in (str(place.parent), "code", "others", "link", ".", ".."):
        done = piezoid(words.replace("--out made", f"--out {out}"))
        assert done.exit_code == 2, (out, done.stderr)
    assert look(place.parent) == before


def test_a_verb_that_adds_refuses_an_edited_file_and_replaces_it_with_force(place: Path) -> None:
    assert piezoid("report stage --quiet").exit_code == 0
    page = place / "stage/report.html"
    page.write_text("my notes")
    done = piezoid("report stage")
    assert done.exit_code == 2
    assert "--force" in done.stderr
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
def test_a_verb_does_not_replace_the_folder_that_it_reads(words: str, place: Path) -> None:
    before = look(place)
    assert piezoid(words).exit_code == 2
    assert look(place) == before


@pytest.mark.parametrize("linked", ["", "o", "o/stages", "o/stages/st1"])
def test_a_batch_keeps_what_lies_where_its_results_would(linked: str, place: Path) -> None:
    """Also behind a symbolic link, and with ``--force``."""
    theirs = place / "theirs/stages/st1"
    theirs.mkdir(parents=True)
    (theirs / "keep.txt").write_text("x")
    if linked:
        (place / linked).parent.mkdir(parents=True, exist_ok=True)
        (place / linked).symlink_to(place / "theirs" / linked[2:])
    else:
        (place / "theirs").rename(place / "o")
    before = look(place)
    for force in ("", "--force"):
        done = piezoid(f"batch night --out o --workers 1 {force}")
        assert done.exit_code == 2, done.stderr
    assert look(place) == before


def test_a_batch_whose_results_lie_among_its_stages_does_again_what_was_removed(
    place: Path,
) -> None:
    words = "batch night --out night/res --workers 1 --json"
    first = piezoid(words)
    model = place / "night/res/stages/st1/model.json"
    written = model.read_bytes()
    model.unlink()
    again = piezoid(words)
    for done in (first, again):
        assert done.stdout.count('"state"') == 1, done.stderr
        assert "night/res" not in done.stderr
    assert model.read_bytes() == written


def test_a_diagnosis_that_was_put_into_the_folder_is_left_out_of_the_report(place: Path) -> None:
    assert "left out" not in piezoid("report stage").output
    other = replace(diagnosed(), explained_fraction=0.5)
    (place / "stage/diagnosis.json").write_bytes(write_diagnosis(other))
    assert "out of date: diagnosis.json" in piezoid("report stage").output
