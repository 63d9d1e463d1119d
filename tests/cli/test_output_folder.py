"""A folder of results is whole or not there; what was there before is never half gone."""

import ctypes
import os
import resource
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import pytest
import typer

from piezoid_cli.output_folder import add_to_folder, check_free, write_file, write_folder

NEW = {"model.json": b"new", "bundle/a.h": b"header"}


def held(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_new_folder_holds_every_file(tmp_path: Path) -> None:
    write_folder(tmp_path / "deep" / "stage", NEW)
    assert held(tmp_path / "deep" / "stage") == NEW
    assert os.listdir(tmp_path / "deep") == ["stage"]


def test_an_old_folder_is_replaced_as_a_whole(tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", {"model.json": b"old", "left.over": b"old"})
    write_folder(tmp_path / "stage", NEW)
    assert held(tmp_path / "stage") == NEW
    assert os.listdir(tmp_path) == ["stage"]


def test_without_an_atomic_exchange_the_folder_is_still_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # No file system of this machine lacks the exchange: here its C library does.
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    write_folder(tmp_path / "stage", {"model.json": b"old"})
    write_folder(tmp_path / "stage", NEW)
    assert held(tmp_path / "stage") == NEW
    assert os.listdir(tmp_path) == ["stage"]


def test_killed_at_any_moment_the_folder_is_old_or_new(tmp_path: Path) -> None:
    target = tmp_path / "stage"
    code = (
        "import sys; from pathlib import Path\n"
        "from piezoid_cli.output_folder import write_folder\n"
        "print('ready', flush=True)\n"
        "n = 0\n"
        "while True:\n"
        "    n += 1\n"
        "    write_folder(Path(sys.argv[1]), {f'{i}.bin': b'%d' % n * 20000 for i in range(8)})\n"
    )
    for round_ in range(8):
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(target)], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.02 + 0.013 * round_)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        if target.exists():
            contents = held(target)
            assert sorted(contents) == [f"{i}.bin" for i in range(8)]
            assert len(set(contents.values())) == 1


def test_a_folder_that_holds_something_is_refused_without_force(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(typer.BadParameter, match="--force"):
        check_free(tmp_path, force=False)
    check_free(tmp_path, force=True)
    check_free(tmp_path / "new", force=False)
    with pytest.raises(typer.BadParameter, match="is a file"):
        check_free(tmp_path / "mine.txt", force=True)
    with pytest.raises(typer.BadParameter, match="a disk of its own"):
        check_free(Path("/"), force=True)


def test_a_folder_another_run_has_filled_meanwhile_is_left_to_it(tmp_path: Path) -> None:
    check_free(tmp_path / "stage", force=False)
    write_folder(tmp_path / "stage", {"model.json": b"theirs"}, force=False)
    with pytest.raises(typer.BadParameter, match="not empty"):
        write_folder(tmp_path / "stage", NEW, force=False)
    assert held(tmp_path / "stage") == {"model.json": b"theirs"}
    assert os.listdir(tmp_path) == ["stage"]


def test_what_killed_runs_left_is_cleared_away_and_nothing_else(tmp_path: Path) -> None:
    for name in (".stage.x7_1.unfinished", ".stage.backup", ".other.x7_1.unfinished"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "half.json").write_bytes(b"{")
    write_folder(tmp_path / "stage", NEW)
    assert sorted(os.listdir(tmp_path)) == [".other.x7_1.unfinished", ".stage.backup", "stage"]


def test_runs_that_add_at_the_same_time_lose_nothing_of_each_other(tmp_path: Path) -> None:
    write_folder(tmp_path / "stage", NEW)
    code = (
        "import sys; from pathlib import Path\n"
        "from piezoid_cli.output_folder import add_to_folder\n"
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
                write(place, {"model.json": bytes(2000)})
            assert told.value.filename == str(place)
        with pytest.raises(OSError, match=r"lab\.toml"):
            write_file(tmp_path / "lab.toml", bytes(2000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, small)
    assert held(place) == {"model.json": b"old"}
    assert os.listdir(tmp_path) == ["stage"]


@pytest.mark.parametrize("force", [False, True])
def test_what_is_read_and_where_we_stand_is_never_replaced(
    force: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = tmp_path / "night" / "runs"
    runs.mkdir(parents=True)
    (runs / "sweep.csv").write_text("precious")
    (tmp_path / "linked").symlink_to(tmp_path / "night")
    for folder in (runs, runs.parent, tmp_path / "linked"):
        with pytest.raises(typer.BadParameter, match="which is read"):
            check_free(folder, force=force, inputs=[runs / "sweep.csv"])
    check_free(runs / "stage", force=force, inputs=[runs / "sweep.csv"])
    monkeypatch.chdir(runs)
    for folder in (Path("."), Path(".."), tmp_path):
        with pytest.raises(typer.BadParameter, match="where this command runs"):
            check_free(folder, force=force)
    assert (runs / "sweep.csv").read_text() == "precious"


def test_results_go_through_a_link_and_leave_it_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "stage").mkdir()
    (tmp_path / "stage").symlink_to(tmp_path / "disk" / "stage")
    write_folder(tmp_path / "stage", NEW)
    assert held(tmp_path / "disk" / "stage") == NEW
    assert (tmp_path / "stage").is_symlink()


def test_a_link_to_itself_is_told_as_what_the_disk_says(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    check_free(tmp_path / "stage", force=True, inputs=[tmp_path / "loop"])
    with pytest.raises(OSError, match="loop"):
        write_folder(tmp_path / "loop", NEW)
    assert os.listdir(tmp_path) == ["loop"]


def test_what_stays_in_a_folder_is_copied_and_never_held_as_a_whole(tmp_path: Path) -> None:
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
