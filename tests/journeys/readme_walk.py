"""Run every shell line of the README and of two pages of the guide, in one shell and folder.

    python tests/journeys/readme_walk.py

Recordings are cut short, so that the walk takes two minutes; the commands are unchanged. The walk
ends with status 1 at the first command that fails. It is too slow for the test suite: the gate
runs it beside the documentation. Its ``make demo`` runs ``piezoid demo``.
"""

import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# In this order: each page continues with the files of the previous one.
WALKED = ("README.md", "docs/guide/command_line.md", "docs/guide/targets.md")
ROWS = 2500
SHORT_ROWS = 1200  # of recordings of the virtual laboratory and of a batch
# The gate makes the environment itself, and installs the wheel in a clean one.
EXCLUDED = ("make ", "python3 -m venv", ".venv/bin/pip")
# `make demo`, another step of the gate, calibrates the whole bundled stage.
DEMO = "piezoid demo "


def lines_of(text: str) -> Iterator[str]:
    """Yield the lines of all shell blocks, except those that make the environment."""
    for block in re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL):
        yield from (line for line in block.splitlines() if not line.startswith(EXCLUDED))


def checkout_in(folder: Path) -> None:
    """Create the files of a checkout after `make demo`, with short recordings."""
    (folder / ".venv").symlink_to(sys.prefix)
    (folder / "datasets").mkdir()
    for recording in sorted((ROOT / "datasets").glob("x_*.csv")):
        (folder / "datasets" / recording.name).write_text(first_rows(recording))


def walk(folder: Path, lines: Iterator[str]) -> int:
    """Run the lines one by one in a shell; return the last status."""
    shell = subprocess.Popen(
        ["bash"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert shell.stdout is not None
    status = 0
    for line in lines:
        _show(f"\n$ {line}\n")
        start_s = time.perf_counter()
        shell.stdin.write(f'{line}\necho "status $? in $PWD"\n')
        shell.stdin.flush()
        for line_out in shell.stdout:
            if end := re.fullmatch(r"status (\d+) in (.*)\n", line_out):
                break
            _show(line_out)
        status, folder_out = int(end[1]), Path(end[2])
        _show(f"[{time.perf_counter() - start_s:.1f} s, status {status}]\n")
        if status:
            break
        for recording in (
            *folder_out.glob("made/recordings/*.csv"),
            *folder_out.glob("night/*/*.csv"),
        ):
            recording.write_text(first_rows(recording, SHORT_ROWS))
    shell.stdin.close()
    shell.wait()
    return status


def _show(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


def first_rows(recording: Path, rows: int = ROWS) -> str:
    """Return the heading and the first rows of a recording."""
    lines = recording.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(lines[: rows + 1])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as checkout:
        checkout_in(Path(checkout))
        pages = [(ROOT / name).read_text(encoding="utf-8") for name in WALKED]
        lines = chain.from_iterable(map(lines_of, pages))
        sys.exit(walk(Path(checkout), (line for line in lines if not line.startswith(DEMO))))
