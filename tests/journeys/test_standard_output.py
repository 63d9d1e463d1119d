"""Limited character sets, full disks and closed pipes do not make a command fail."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.journeys.command import PIEZOID

ROWS = "".join(f"{k / 100},{k % 9},{2 * (k % 9)}\n" for k in range(60))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "s.csv"
    path.write_text("time [s],voltage [V],position [µm]\n" + ROWS, encoding="utf-8")
    return path


def test_characters_that_a_terminal_lacks_are_replaced(recording):
    out = recording.with_name("lab.toml")
    for words in (("inspect", recording), ("init", recording, "--out", out)):
        result = subprocess.run(
            [*PIEZOID, *words],
            env={**os.environ, "PYTHONIOENCODING": "ascii"},
            capture_output=True,
            check=False,
        )
        assert result.returncode == 0, result.stderr
    assert "µm" in out.read_text(encoding="utf-8")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize("flags", [(), ("--json",)])
def test_a_full_disk_behind_standard_output_is_named(flags, recording):
    with Path("/dev/full").open("wb") as full_device:
        result = subprocess.run(
            [*PIEZOID, "inspect", recording, *flags],
            stdout=full_device,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert result.returncode == 3
    assert b"error: standard output: No space left" in result.stderr
    assert result.stderr.count(b"error") == 1


def test_a_closed_pipe_changes_neither_the_results_nor_the_status(recording):
    out = recording.with_name("lab.toml")
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed_pipe:
        result = subprocess.run(
            [*PIEZOID, "init", recording, "--out", out],
            stdout=closed_pipe,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert (result.returncode, result.stderr) == (0, b"")
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
def test_an_unwritable_stream_does_not_change_the_exit_status(words, stream, status, recording):
    """The status is neither 1, a failed verdict, nor 70, an internal error."""
    line = f'"{PIEZOID[0]}" -m {PIEZOID[2]} {words} {stream}'
    result = subprocess.run(
        line, shell=True, cwd=recording.parent, capture_output=True, check=False
    )
    assert result.returncode == status, result.stderr
    assert b"Traceback" not in result.stderr
