"""A terminal of few characters, a full disk and a closed pipe are no fault of a command."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.journeys.command import PIEZOID

ROWS = "".join(f"{k / 100},{k % 9},{2 * (k % 9)}\n" for k in range(60))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    place = tmp_path / "s.csv"
    place.write_text("time [s],voltage [V],position [µm]\n" + ROWS, encoding="utf-8")
    return place


def test_characters_that_a_terminal_has_not_degrade(recording):
    out = recording.with_name("lab.toml")
    for words in (("inspect", recording), ("init", recording, "--out", out)):
        done = subprocess.run(
            [*PIEZOID, *words],
            env={**os.environ, "PYTHONIOENCODING": "ascii"},
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    assert "µm" in out.read_text(encoding="utf-8")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize("flags", [(), ("--json",)])
def test_a_full_disk_behind_standard_output_is_named(flags, recording):
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [*PIEZOID, "inspect", recording, *flags],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 3
    assert b"error: standard output: No space left" in done.stderr
    assert done.stderr.count(b"error") == 1


def test_a_closed_pipe_ends_neither_the_work_nor_its_status(recording):
    out = recording.with_name("lab.toml")
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed:
        done = subprocess.run(
            [*PIEZOID, "init", recording, "--out", out],
            stdout=closed,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert (done.returncode, done.stderr) == (0, b"")
    assert out.exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize(
    ("words", "stream", "status"),
    [
        ("inspect s.csv", ">&-", 0),
        ("inspect gone.csv", "2>&-", 3),
        ("inspect gone.csv", "2>/dev/full", 3),
        ("inspect --nope", "2>/dev/full", 2),
    ],
)
def test_a_stream_that_cannot_be_written_changes_no_exit_status(words, stream, status, recording):
    """Neither 1, a failed verdict, nor 70, an internal error."""
    line = f'"{PIEZOID[0]}" -m {PIEZOID[2]} {words} {stream}'
    done = subprocess.run(line, shell=True, cwd=recording.parent, capture_output=True, check=False)
    assert done.returncode == status, done.stderr
    assert b"Traceback" not in done.stderr
