"""Every shell line of the README and of the command line's page, in one shell and an empty folder.

    python tests/journeys/readme_walk.py

Bundled recordings and those of the virtual laboratory are cut short, so that the walk takes two
minutes; nothing else differs from what somebody types. Ends with status 1 at the first line that
does not end with status 0. It is too slow for the suite: the gate runs it, after ``make demo``,
which runs ``piezoid demo``.
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
# In this order: each goes on with what the one before has written.
WALKED = ("README.md", "docs/guide/command_line.md", "docs/guide/targets.md")
ROWS = 2500
SHORT_ROWS = 1200  # of recordings of the virtual laboratory and of a batch
# The gate makes the environment itself, and installs the wheel in a clean one.
APART = ("make ", "python3 -m venv", ".venv/bin/pip")
# `make demo`, the step of the gate before, has calibrated the whole bundled stage.
DEMO = "piezoid demo "


def lines_of(text: str) -> Iterator[str]:
    """Yield the lines of all shell blocks, except those that make the environment."""
    for block in re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL):
        yield from (line for line in block.splitlines() if not line.startswith(APART))


def checkout_in(folder: Path) -> None:
    """Put into a folder what a checkout has after `make demo`, with recordings cut short."""
    (folder / ".venv").symlink_to(sys.prefix)
    (folder / "datasets").mkdir()
    for recording in sorted((ROOT / "datasets").glob("x_*.csv")):
        (folder / "datasets" / recording.name).write_text(shortened(recording))


def walk(folder: Path, lines: Iterator[str]) -> int:
    """Type the lines one after the other into one shell; return the last status."""
    shell = subprocess.Popen(
        ["bash"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert shell.stdin is not None
    assert shell.stdout is not None
    status = 0
    for line in lines:
        _show(f"\n$ {line}\n")
        began = time.perf_counter()
        shell.stdin.write(f'{line}\necho "status $? in $PWD"\n')
        shell.stdin.flush()
        for said in shell.stdout:
            if ended := re.fullmatch(r"status (\d+) in (.*)\n", said):
                break
            _show(said)
        status, place = int(ended[1]), Path(ended[2])
        _show(f"[{time.perf_counter() - began:.1f} s, status {status}]\n")
        if status:
            break
        for made in (*place.glob("made/recordings/*.csv"), *place.glob("night/*/*.csv")):
            made.write_text(shortened(made, SHORT_ROWS))
    shell.stdin.close()
    shell.wait()
    return status


def _show(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


def shortened(recording: Path, rows: int = ROWS) -> str:
    """Return the heading and the first rows of a recording."""
    lines = recording.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(lines[: rows + 1])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        checkout_in(Path(made))
        pages = [(ROOT / name).read_text(encoding="utf-8") for name in WALKED]
        lines = chain.from_iterable(map(lines_of, pages))
        sys.exit(walk(Path(made), (line for line in lines if not line.startswith(DEMO))))
