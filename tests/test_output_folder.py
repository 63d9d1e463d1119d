"""Results are written completely or not at all, and foreign objects are kept."""

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
from functools import partial
from pathlib import Path

import pytest

from piezoid.digests import seal
from piezoid.errors import OutputFolderError
from piezoid.manifest import MANIFEST, lists_results
from piezoid.output_folder import add_to_folder, check_folder, write_file, write_folder
from tests.foreign_objects import KINDS, look, plant

NEW = {"model.json": b"new", "bundle/a.h": b"header"}
OLD = {"model.json": b"old", "bundle/a.h": b"old", "bundle/b.h": b"old", "report.html": b"old"}


def contents_of(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != MANIFEST
    }


WRITES = {
    "replace": partial(write_folder, force=True),
    "add": add_to_folder,
    "gone": partial(add_to_folder, gone=("bundle",)),
}
# Locations of a foreign object, and whether the results are written there.
IS_WRITTEN = {
    "notes": False,
    "bundle/notes": False,
    "mine/notes": False,
    "model.json": True,
    "new.json": True,
    "bundle/a.h": True,
}


@pytest.fixture(params=[False, True], ids=["exchange", "no-exchange"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Use the C library of this machine, and a library that cannot exchange two folders."""
    if request.param:
        monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())


def test_a_new_folder_contains_every_file(tmp_path):
    write_folder(tmp_path / "deep" / "stage", NEW)
    assert contents_of(tmp_path / "deep" / "stage") == NEW
    assert os.listdir(tmp_path / "deep") == ["stage"]
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    write_folder(tmp_path / "link" / "stage", NEW)
    assert contents_of(tmp_path / "disk" / "stage") == NEW


@pytest.mark.usefixtures("system")
def test_with_force_results_are_replaced_as_a_whole(tmp_path):
    write_folder(tmp_path / "stage", OLD)
    write_folder(tmp_path / "stage", NEW, force=True)
    assert contents_of(tmp_path / "stage") == NEW
    assert os.listdir(tmp_path) == ["stage"]


@pytest.mark.parametrize("write_name", WRITES)
@pytest.mark.parametrize("name", IS_WRITTEN)
@pytest.mark.parametrize(
    ("moment", "kind"),
    [*(("before", kind) for kind in KINDS), *(("during", kind) for kind in KINDS[::3])],
)
def test_a_foreign_object_is_never_changed(kind, name, moment, write_name, tmp_path):
    """Objects of every type are created at every location, before and during the writing."""
    stage = tmp_path / "stage"
    write_folder(stage, OLD)
    beyond = tmp_path / "beyond"
    original = None

    def appear() -> None:
        nonlocal original
        if (stage / name).is_file():
            (stage / name).unlink()
        plant(kind, stage / name, beyond)
        original = look(stage / name), look(beyond)

    def write_slowly(stream: object) -> None:
        if moment == "during":
            appear()
        stream.write(b"fresh")  # type: ignore[attr-defined]

    if moment == "before":
        appear()
    contents = {"model.json": write_slowly, "bundle/a.h": b"fresh", "new.json": b"fresh"}
    is_edited = name in OLD and kind in ("file", "private file")  # an edited result
    is_replaced = is_edited and write_name == "replace"
    if IS_WRITTEN[name] and not is_replaced:
        with pytest.raises(OutputFolderError):
            WRITES[write_name](stage, contents)
        assert contents_of(stage).get("report.html") == b"old"
        assert b"fresh" not in contents_of(stage).values()
    else:
        WRITES[write_name](stage, contents)
        assert (stage / "new.json").read_bytes() == b"fresh"
        assert (stage / "report.html").exists() == (write_name != "replace")
        assert (stage / "bundle/b.h").exists() == (write_name == "add")
    if not is_replaced:
        assert (look(stage / name), look(beyond)) == original
    assert {path.name for path in tmp_path.iterdir()} <= {"stage", "beyond"}


@pytest.mark.usefixtures("system")
@pytest.mark.parametrize("write_name", WRITES)
def test_modes_are_kept(write_name, tmp_path):
    write_folder(tmp_path / "stage", OLD)
    modes = {"": 0o750, "bundle": 0o711, "model.json": 0o600, "report.html": 0o640}
    for name, mode in modes.items():
        (tmp_path / "stage" / name).chmod(mode)
    WRITES[write_name](tmp_path / "stage", {**NEW, "report.html": b"new"})
    for name, mode in modes.items():
        assert (tmp_path / "stage" / name).stat().st_mode & 0o777 == mode, name


def test_an_edited_result_is_replaced_with_force_only(tmp_path):
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "stage/report.html").write_bytes(b"with my notes")
    for removed in ((), ("report.html",)):
        with pytest.raises(OutputFolderError, match=r"report\.html was edited"):
            add_to_folder(
                tmp_path / "stage", {} if removed else {"report.html": b""}, gone=removed
            )
    add_to_folder(tmp_path / "stage", {"model.json": b"new"})
    assert (tmp_path / "stage/report.html").read_bytes() == b"with my notes"
    add_to_folder(tmp_path / "stage", {"report.html": b"new"}, force=True)
    assert (tmp_path / "stage/report.html").read_bytes() == b"new"


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_without_a_manifest_is_always_refused(force, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("precious")
    (mine / MANIFEST).write_text('{"schema": "piezoid.manifest/1", "files": {"notes.txt": "x"}}')
    for write in (write_folder, add_to_folder):
        with pytest.raises(OutputFolderError, match="--force"):
            write(mine, NEW, force=force)
    assert contents_of(mine) == {"notes.txt": b"precious"}
    with pytest.raises(OutputFolderError, match="is a file"):
        check_folder(mine / "notes.txt", force=force)
    with pytest.raises(OutputFolderError, match="the root of a disk"):
        check_folder("/", force=force)


@pytest.mark.parametrize("name", ["../precious", "/tmp/precious", "a/../../precious", ""])
def test_a_manifest_with_files_elsewhere_is_invalid(name, tmp_path):
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "precious").write_text("mine")
    digest = f"sha256:{0:064x}"
    sealed = seal("piezoid.manifest/1", {"files": {name: digest}})
    (tmp_path / "stage" / MANIFEST).write_bytes(sealed)
    with pytest.raises(OutputFolderError, match="no manifest"):
        write_folder(tmp_path / "stage", NEW, force=True)
    assert (tmp_path / "precious").read_text() == "mine"


def test_without_a_manifest_only_sealed_files_are_results(tmp_path):
    """Earlier versions wrote no manifest, and users copy sealed files into folders."""
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
    assert contents_of(stage).keys() == {"report.html", "design.json", "lab.toml", "notes.json"}


@pytest.mark.parametrize("force", [False, True])
def test_protected_folders_are_refused_even_with_a_manifest(force, tmp_path, monkeypatch):
    folders = {name: tmp_path / name for name in ("home/me", "runs/stage", "code")}
    for folder in folders.values():
        write_folder(folder, OLD)
    (folders["code"] / ".git").mkdir()
    (tmp_path / "runs/stage/sub").mkdir()
    monkeypatch.setenv("HOME", str(folders["home/me"]))
    monkeypatch.chdir(tmp_path / "runs/stage/sub")
    reasons = {
        "home folder": (folders["home/me"], tmp_path / "home", "~/"),
        "the working directory": (
            Path("."),
            Path(".."),
            folders["runs/stage"],
            tmp_path / "runs",
        ),
        "repository": (folders["code"],),
    }
    for reason, protected in reasons.items():
        for folder in protected:
            for write in (write_folder, add_to_folder):
                with pytest.raises(OutputFolderError, match=reason):
                    write(Path(folder).expanduser(), NEW, force=force)
    assert all(contents_of(folder) == OLD for folder in folders.values())


def test_inputs_and_files_are_never_replaced(tmp_path):
    write_folder(tmp_path / "night", {"runs/sweep.csv": b"1"})
    for folder in (tmp_path / "night", tmp_path / "night/runs"):
        with pytest.raises(OutputFolderError, match="which is read"):
            check_folder(folder, force=True, inputs=[tmp_path / "night/runs/sweep.csv"])
    (tmp_path / "s.csv").write_text("precious")
    with pytest.raises(OutputFolderError, match=r"s\.csv is a file"):
        check_folder(tmp_path / "s.csv/stage")


@pytest.mark.parametrize("target", ["stage", "nowhere", "."])
def test_a_link_is_not_followed(target, tmp_path):
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "link").symlink_to(tmp_path / target)
    for write in (write_folder, add_to_folder):
        with pytest.raises(OutputFolderError, match="link"):
            write(tmp_path / "link", NEW, force=True)
    assert contents_of(tmp_path / "stage") == OLD
    assert sorted(os.listdir(tmp_path)) == ["link", "stage"]


def kill_while_writing(stage: Path, after_s: float) -> None:
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


def test_after_a_kill_the_folder_is_old_or_new(tmp_path):
    for round_ in range(8):
        kill_while_writing(tmp_path / "stage", 0.02 + 0.013 * round_)
        if (tmp_path / "stage").exists():
            contents = contents_of(tmp_path / "stage")
            assert sorted(contents) == [f"{i}.bin" for i in range(8)]
            assert len(set(contents.values())) == 1


def test_after_a_kill_with_foreign_files_each_file_is_complete(tmp_path):
    stage = tmp_path / "stage"
    write_folder(stage, OLD)
    (stage / "notes").write_text("mine")
    for round_ in range(8):
        kill_while_writing(stage, 0.02 + 0.013 * round_)
        for name, content in contents_of(stage).items():
            if name.endswith(".bin"):
                assert len(content) % 20000 == 0
                assert len(set(content[k : k + 1] for k in range(0, len(content), 20000))) == 1
    write_folder(stage, NEW, force=True)
    assert contents_of(stage) == {**NEW, "notes": b"mine"}
    assert os.listdir(tmp_path) == ["stage"]


def test_an_object_that_appears_during_the_exchange_is_kept(tmp_path, monkeypatch):
    write_folder(tmp_path / "stage", OLD)
    chmod = Path.chmod

    def chmod_with_note(path: Path, mode: int) -> None:  # after the check, before the exchange
        (tmp_path / "stage/bundle/notes").write_text("mine")
        chmod(path, mode)

    monkeypatch.setattr(Path, "chmod", chmod_with_note)
    write_folder(tmp_path / "stage", NEW, force=True)
    assert contents_of(tmp_path / "stage") == {**NEW, "bundle/notes": b"mine"}
    assert os.listdir(tmp_path) == ["stage"]


def test_a_folder_filled_by_another_run_is_refused(tmp_path):
    check_folder(tmp_path / "stage", new=True)
    write_folder(tmp_path / "stage", {"model.json": b"theirs"})
    with pytest.raises(OutputFolderError, match="not empty"):
        write_folder(tmp_path / "stage", NEW)
    assert contents_of(tmp_path / "stage") == {"model.json": b"theirs"}
    assert os.listdir(tmp_path) == ["stage"]


def test_only_remains_of_killed_runs_are_removed(tmp_path):
    for name in (".stage.x7.unfinished", ".stage.b.x7.unfinished", ".stage.backup"):
        write_folder(tmp_path / name, OLD)
    (tmp_path / ".stage.y8.unfinished").mkdir()
    (tmp_path / ".stage.y8.unfinished/precious").write_text("mine")
    write_folder(tmp_path / "stage", NEW)
    remaining = {".stage.b.x7.unfinished", ".stage.backup", ".stage.y8.unfinished", "stage"}
    assert set(os.listdir(tmp_path)) == remaining
    assert (tmp_path / ".stage.y8.unfinished/precious").read_text() == "mine"


@pytest.mark.parametrize("files_written", range(6))
def test_remains_of_a_run_killed_at_any_step_are_removed(files_written, tmp_path):
    """The process exits while its n-th file is empty, without removing anything."""
    write_folder(tmp_path / "stage", OLD)
    (tmp_path / "stage/notes").write_text("mine")
    child = os.fork()
    if child == 0:
        open_file, count = Path.open, iter(range(99))

        def open_or_exit(path: Path, mode: str = "r") -> object:
            stream = open_file(path, mode)
            return os._exit(9) if mode == "w+b" and next(count) == files_written else stream

        Path.open = open_or_exit  # type: ignore[method-assign, assignment]
        write_folder(tmp_path / "stage", NEW, force=True)
        os._exit(0)
    os.waitpid(child, 0)
    write_folder(tmp_path / "stage", NEW, force=True)
    assert os.listdir(tmp_path) == ["stage"]
    assert contents_of(tmp_path / "stage") == {**NEW, "notes": b"mine"}


def test_simultaneous_runs_lose_no_file(tmp_path):
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
    assert len(contents_of(tmp_path / "stage")) == len(NEW) + 2 * 8


def test_an_error_of_the_disk_names_the_folder(tmp_path):
    stage = tmp_path / "stage"
    write_folder(stage, {"model.json": b"old"})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        for write in (write_folder, add_to_folder):
            with pytest.raises(OSError, match="large") as error:
                write(stage, {"model.json": bytes(2000)}, force=True)
            assert error.value.filename == str(stage)
        with pytest.raises(OSError, match=r"lab\.toml"):
            write_file(tmp_path / "lab.toml", bytes(2000), opening=b"")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert contents_of(stage) == {"model.json": b"old"}
    assert os.listdir(tmp_path) == ["stage"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_single_file_replaces_only_results_and_with_force(kind, tmp_path):
    path, content = tmp_path / "lab.toml", b"# by piezoid\n"
    plant(kind, path, tmp_path / "beyond")
    original = look(path)
    for force in (False, True):
        with pytest.raises(OutputFolderError):
            write_file(path, content, opening=content, force=force)
    assert look(path) == original
    shutil.rmtree(path) if kind.endswith("folder") and kind[0] != "l" else path.unlink()
    write_file(path, content, opening=content)
    path.chmod(0o600)
    with pytest.raises(OutputFolderError, match="already exists"):
        write_file(path, content + b"2", opening=content)
    write_file(path, content + b"2", opening=content, force=True)
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (content + b"2", 0o600)


def test_kept_files_are_not_read_into_memory(tmp_path):
    night = b"1,2\n" * 4_000_000
    write_folder(tmp_path / "stage", {"sub/night.csv": night, "report.html": b"old"})
    tracemalloc.start()
    try:
        add_to_folder(tmp_path / "stage", {"report.html": b"new"})
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 0.1 * len(night)
    assert contents_of(tmp_path / "stage") == {"sub/night.csv": night, "report.html": b"new"}


def test_the_manifest_does_not_depend_on_the_order_of_writing(tmp_path):
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
