"""Results are written whole or not at all, and nothing that piezoid did not write is touched."""

import ctypes
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from piezoid.digests import seal
from piezoid.errors import OutputFolderError
from piezoid.manifest import MANIFEST, lists_results
from piezoid.output_folder import add_to_folder, check_folder, write_file, write_folder
from tests.foreign_objects import KINDS, look, plant

NEW = {"model.json": b"new", "bundle/a.h": b"header"}
OLD = {"model.json": b"old", "bundle/a.h": b"old", "bundle/b.h": b"old", "report.html": b"old"}


def held(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != MANIFEST
    }


def replace_all(folder: Path, contents: dict) -> None:
    write_folder(folder, contents, force=True)


def add(folder: Path, contents: dict) -> None:
    add_to_folder(folder, contents)


def export_again(folder: Path, contents: dict) -> None:
    add_to_folder(folder, contents, gone=("bundle",))


WAYS = {"replace": replace_all, "add": add, "gone": export_again}
# Where an object of somebody else lies, and whether the write needs that very place.
PLACES = {
    "notes": False,
    "bundle/notes": False,
    "mine/notes": False,
    "model.json": True,
    "new.json": True,
    "bundle/a.h": True,
}


@pytest.fixture(params=[False, True], ids=["exchange", "no-exchange"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The C library of this machine, and one that cannot exchange two folders."""
    if request.param:
        monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())


def test_a_new_folder_holds_every_file(tmp_path: Path) -> None:
    write_folder(tmp_path / "deep" / "stage", NEW)
    assert held(tmp_path / "deep" / "stage") == NEW
    assert os.listdir(tmp_path / "deep") == ["stage"]


@pytest.mark.usefixtures("system")
def test_with_force_results_are_replaced_as_a_whole(tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", OLD)
    write_folder(tmp_path / "stage", NEW, force=True)
    assert held(tmp_path / "stage") == NEW
    assert os.listdir(tmp_path) == ["stage"]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    ("when", "kind"),
    [*(("before", kind) for kind in KINDS), *(("during", kind) for kind in KINDS[::3])],
)
def test_an_object_of_somebody_else_stays_as_it_is(
    kind: str, place: str, when: str, way: str, tmp_path: Path
) -> None:
    """Every kind of object, everywhere, there before and put there while files are written."""
    stage = tmp_path / "stage"
    write_folder(stage, OLD)
    beyond = tmp_path / "beyond"
    seen = None

    def appear() -> None:
        nonlocal seen
        if (stage / place).is_file():
            (stage / place).unlink()
        plant(kind, stage / place, beyond)
        seen = look(stage / place), look(beyond)

    def slowly(stream: object) -> None:
        if when == "during":
            appear()
        stream.write(b"fresh")  # type: ignore[attr-defined]

    if when == "before":
        appear()
    contents = {"model.json": slowly, "bundle/a.h": b"fresh", "new.json": b"fresh"}
    is_edited = place in OLD and kind in ("file", "private file")  # one of ours, then
    is_replaced = is_edited and way == "replace"
    if PLACES[place] and not is_replaced:
        with pytest.raises(OutputFolderError):
            WAYS[way](stage, contents)
        assert held(stage).get("report.html") == b"old"
        assert b"fresh" not in held(stage).values()
    else:
        WAYS[way](stage, contents)
        assert (stage / "new.json").read_bytes() == b"fresh"
        assert (stage / "report.html").exists() == (way != "replace")
        assert (stage / "bundle/b.h").exists() == (way == "add")
    if not is_replaced:
        assert (look(stage / place), look(beyond)) == seen
    assert {path.name for path in tmp_path.iterdir()} <= {"stage", "beyond"}


@pytest.mark.usefixtures("system")
@pytest.mark.parametrize("way", WAYS)
def test_modes_stay(way: str, tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", OLD)
    modes = {"": 0o750, "bundle": 0o711, "model.json": 0o600, "report.html": 0o640}
    for name, mode in modes.items():
        (tmp_path / "stage" / name).chmod(mode)
    WAYS[way](tmp_path / "stage", {**NEW, "report.html": b"new"})
    for name, mode in modes.items():
        assert (tmp_path / "stage" / name).stat().st_mode & 0o777 == mode, name


def test_an_edited_file_of_ours_is_replaced_with_force_only(tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "stage/report.html").write_bytes(b"with my notes")
    for gone in ((), ("report.html",)):
        with pytest.raises(OutputFolderError, match=r"report\.html was edited"):
            add_to_folder(tmp_path / "stage", {} if gone else {"report.html": b""}, gone=gone)
    add_to_folder(tmp_path / "stage", {"model.json": b"new"})
    assert (tmp_path / "stage/report.html").read_bytes() == b"with my notes"
    add_to_folder(tmp_path / "stage", {"report.html": b"new"}, force=True)
    assert (tmp_path / "stage/report.html").read_bytes() == b"new"


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_without_our_manifest_is_refused_whatever_the_flags_say(
    force: bool, tmp_path: Path
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("precious")
    (mine / MANIFEST).write_text('{"schema": "piezoid.manifest/1", "files": {"notes.txt": "x"}}')
    for write in (write_folder, add_to_folder):
        with pytest.raises(OutputFolderError, match="--force"):
            write(mine, NEW, force=force)
    assert held(mine) == {"notes.txt": b"precious"}
    with pytest.raises(OutputFolderError, match="is a file"):
        check_folder(mine / "notes.txt", force=force)
    with pytest.raises(OutputFolderError, match="the root of a disk"):
        check_folder("/", force=force)


@pytest.mark.parametrize("name", ["../precious", "/tmp/precious", "a/../../precious", ""])
def test_a_manifest_that_names_files_elsewhere_is_none(name: str, tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "precious").write_text("mine")
    digest = f"sha256:{0:064x}"
    sealed = seal("piezoid.manifest/1", {"files": {name: digest}})
    (tmp_path / "stage" / MANIFEST).write_bytes(sealed)
    with pytest.raises(OutputFolderError, match="no manifest"):
        write_folder(tmp_path / "stage", NEW, force=True)
    assert (tmp_path / "precious").read_text() == "mine"


def test_without_a_manifest_sealed_files_are_ours_and_others_need_force(tmp_path: Path) -> None:
    """A folder of an earlier version, or one into which a sealed file was copied."""
    stage = tmp_path / "stage"
    stage.mkdir()
    (stage / "model.json").write_bytes(seal("piezoid.model/1", {}))
    (stage / "report.html").write_text("page")
    (stage / "lab.toml").write_text("mine")
    (stage / "notes.json").write_text("{}")
    with pytest.raises(OutputFolderError, match=r"report\.html is in no manifest.*--force"):
        add_to_folder(stage, {"report.html": b""})
    for name in ("lab.toml", "notes.json"):
        with pytest.raises(OutputFolderError, match="not written by piezoid"):
            write_folder(stage, {name: b""}, force=True)
    write_folder(stage, {"report.html": b"", "design.json": b""}, force=True)
    assert held(stage).keys() == {"report.html", "design.json", "lab.toml", "notes.json"}


@pytest.mark.parametrize("force", [False, True])
def test_protected_folders_are_refused_even_where_they_bear_our_manifest(
    force: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = {name: tmp_path / name for name in ("home/me", "runs/stage", "code")}
    for folder in places.values():
        write_folder(folder, OLD)
    (places["code"] / ".git").mkdir()
    (tmp_path / "runs/stage/sub").mkdir()
    monkeypatch.setenv("HOME", str(places["home/me"]))
    monkeypatch.chdir(tmp_path / "runs/stage/sub")
    refused = {
        "home folder": (places["home/me"], tmp_path / "home", "~/"),
        "the working directory": (
            Path("."),
            Path(".."),
            places["runs/stage"],
            tmp_path / "runs",
        ),
        "repository": (places["code"],),
    }
    for reason, folders in refused.items():
        for folder in folders:
            for write in (write_folder, add_to_folder):
                with pytest.raises(OutputFolderError, match=reason):
                    write(Path(folder).expanduser(), NEW, force=force)
    assert all(held(folder) == OLD for folder in places.values())


def test_what_is_read_is_never_replaced(tmp_path: Path) -> None:
    write_folder(tmp_path / "night", {"runs/sweep.csv": b"1"})
    for folder in (tmp_path / "night", tmp_path / "night/runs"):
        with pytest.raises(OutputFolderError, match="which is read"):
            check_folder(folder, force=True, inputs=[tmp_path / "night/runs/sweep.csv"])


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("precious")
    with pytest.raises(OutputFolderError, match=r"s\.csv is a file"):
        check_folder(tmp_path / "s.csv/stage")


@pytest.mark.parametrize("target", ["stage", "nowhere", "."])
def test_a_link_is_not_followed(target: str, tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "link").symlink_to(tmp_path / target)
    for write in (write_folder, add_to_folder):
        with pytest.raises(OutputFolderError, match="link"):
            write(tmp_path / "link", NEW, force=True)
    assert held(tmp_path / "stage") == OLD
    assert sorted(os.listdir(tmp_path)) == ["link", "stage"]


def test_a_link_above_the_folder_is_a_name_like_any_other(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    write_folder(tmp_path / "link" / "stage", NEW)
    assert held(tmp_path / "disk" / "stage") == NEW


def killed_while_writing(stage: Path, after_s: float) -> None:
    code = (
        "import sys; from pathlib import Path\n"
        "from piezoid.output_folder import write_folder\n"
        "print('ready', flush=True)\n"
        "n = 0\n"
        "while True:\n"
        "    n += 1\n"
        "    files = {f'{i}.bin': b'%d' % n * 20000 for i in range(8)}\n"
        "    write_folder(Path(sys.argv[1]), files, force=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(stage)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()


def test_killed_at_any_moment_the_folder_is_old_or_new(tmp_path: Path) -> None:
    for round_ in range(8):
        killed_while_writing(tmp_path / "stage", 0.02 + 0.013 * round_)
        if (tmp_path / "stage").exists():
            contents = held(tmp_path / "stage")
            assert sorted(contents) == [f"{i}.bin" for i in range(8)]
            assert len(set(contents.values())) == 1


def test_killed_beside_foreign_files_each_file_is_whole_and_the_next_run_goes_on(
    tmp_path: Path,
) -> None:
    stage = tmp_path / "stage"
    write_folder(stage, OLD)
    (stage / "notes").write_text("mine")
    for round_ in range(8):
        killed_while_writing(stage, 0.02 + 0.013 * round_)
        for name, content in held(stage).items():
            if name.endswith(".bin"):
                assert len(content) % 20000 == 0
                assert len(set(content[k : k + 1] for k in range(0, len(content), 20000))) == 1
    write_folder(stage, NEW, force=True)
    assert held(stage) == {**NEW, "notes": b"mine"}
    assert os.listdir(tmp_path) == ["stage"]


def test_an_object_that_appears_at_the_moment_of_the_exchange_comes_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_folder(tmp_path / "stage", OLD)
    chmod = Path.chmod

    def late(place: Path, mode: int) -> None:  # after the last look, before the exchange
        (tmp_path / "stage/bundle/notes").write_text("mine")
        chmod(place, mode)

    monkeypatch.setattr(Path, "chmod", late)
    write_folder(tmp_path / "stage", NEW, force=True)
    assert held(tmp_path / "stage") == {**NEW, "bundle/notes": b"mine"}
    assert os.listdir(tmp_path) == ["stage"]


def test_a_folder_another_run_has_filled_meanwhile_is_left_to_it(tmp_path: Path) -> None:
    check_folder(tmp_path / "stage", new=True)
    write_folder(tmp_path / "stage", {"model.json": b"theirs"})
    with pytest.raises(OutputFolderError, match="not empty"):
        write_folder(tmp_path / "stage", NEW)
    assert held(tmp_path / "stage") == {"model.json": b"theirs"}
    assert os.listdir(tmp_path) == ["stage"]


def test_what_killed_runs_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    for name in (".stage.x7.unfinished", ".stage.b.x7.unfinished", ".stage.backup"):
        write_folder(tmp_path / name, OLD)
    (tmp_path / ".stage.y8.unfinished").mkdir()
    (tmp_path / ".stage.y8.unfinished/precious").write_text("mine")
    write_folder(tmp_path / "stage", NEW)
    left = {".stage.b.x7.unfinished", ".stage.backup", ".stage.y8.unfinished", "stage"}
    assert set(os.listdir(tmp_path)) == left
    assert (tmp_path / ".stage.y8.unfinished/precious").read_text() == "mine"


@pytest.mark.parametrize("written", range(6))
def test_what_is_left_of_a_run_killed_at_any_step_is_removed(written: int, tmp_path: Path) -> None:
    """The process ends when its n-th file is still empty, and removes nothing itself."""
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "stage/notes").write_text("mine")
    child = os.fork()
    if child == 0:
        opened, count = Path.open, iter(range(99))

        def killed(place: Path, mode: str = "r") -> object:
            stream = opened(place, mode)
            return os._exit(9) if mode == "w+b" and next(count) == written else stream

        Path.open = killed  # type: ignore[method-assign, assignment]
        write_folder(tmp_path / "stage", NEW, force=True)
        os._exit(0)
    os.waitpid(child, 0)
    write_folder(tmp_path / "stage", NEW, force=True)
    assert os.listdir(tmp_path) == ["stage"]
    assert held(tmp_path / "stage") == {**NEW, "notes": b"mine"}


def test_runs_that_add_at_the_same_time_lose_nothing_of_each_other(tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", NEW)
    code = (
        "import sys; from pathlib import Path\n"
        "from piezoid.output_folder import add_to_folder\n"
        "for n in range(8):\n"
        "    add_to_folder(Path(sys.argv[1]), {f'{sys.argv[2]}{n}': b'here'})\n"
    )
    runs = [
        subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "stage"), name])
        for name in "ab"
    ]
    assert [run.wait() for run in runs] == [0, 0]
    assert len(held(tmp_path / "stage")) == len(NEW) + 2 * 8


def test_a_full_disk_is_told_with_the_name_of_the_folder(tmp_path: Path) -> None:
    place = tmp_path / "stage"
    write_folder(place, {"model.json": b"old"})
    small = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, small[1]))
    try:
        for write in (write_folder, add_to_folder):
            with pytest.raises(OSError, match="large") as told:
                write(place, {"model.json": bytes(2000)}, force=True)
            assert told.value.filename == str(place)
        with pytest.raises(OSError, match=r"lab\.toml"):
            write_file(tmp_path / "lab.toml", bytes(2000), opening=b"")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, small)
    assert held(place) == {"model.json": b"old"}
    assert os.listdir(tmp_path) == ["stage"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_single_file_replaces_one_of_ours_with_force_and_nothing_else(
    kind: str, tmp_path: Path
) -> None:
    place, ours = tmp_path / "lab.toml", b"# by piezoid\n"
    plant(kind, place, tmp_path / "beyond")
    seen = look(place)
    for force in (False, True):
        with pytest.raises(OutputFolderError):
            write_file(place, ours, opening=ours, force=force)
    assert look(place) == seen
    shutil.rmtree(place) if kind.endswith("folder") and kind[0] != "l" else place.unlink()
    write_file(place, ours, opening=ours)
    place.chmod(0o600)
    with pytest.raises(OutputFolderError, match="already exists"):
        write_file(place, ours + b"2", opening=ours)
    write_file(place, ours + b"2", opening=ours, force=True)
    assert (place.read_bytes(), place.stat().st_mode & 0o777) == (ours + b"2", 0o600)


def test_what_stays_in_a_folder_is_never_held_as_a_whole(tmp_path: Path) -> None:
    night = b"1,2\n" * 4_000_000
    write_folder(tmp_path / "stage", {"sub/night.csv": night, "report.html": b"old"})
    tracemalloc.start()
    try:
        add_to_folder(tmp_path / "stage", {"report.html": b"new"})
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 0.1 * len(night)
    assert held(tmp_path / "stage") == {"sub/night.csv": night, "report.html": b"new"}


def test_the_same_results_have_the_same_manifest_however_they_were_written(tmp_path: Path) -> None:
    def by_steps(stage: Path) -> None:
        write_folder(stage, {"model.json": b"new"})
        add_to_folder(stage, OLD, force=True)
        add_to_folder(stage, NEW, gone=("report.html", "bundle"))

    writers: dict[str, Callable[[Path], None]] = {
        "a": lambda stage: write_folder(stage, NEW),
        "b": by_steps,
    }
    for name, write in writers.items():
        write(tmp_path / name)
    assert (tmp_path / "a" / MANIFEST).read_bytes() == (tmp_path / "b" / MANIFEST).read_bytes()
    assert lists_results(tmp_path / "a")
