"""The command line as somebody types it: in this process, or in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

from click.testing import Result
from typer.testing import CliRunner

from piezoid_cli.main import app

PIEZOID = (sys.executable, "-m", "piezoid_cli.main")


def piezoid(*words: str | Path) -> Result:
    return CliRunner(env={"COLUMNS": "300"}).invoke(app, [str(word) for word in words])


def run(*words: str | Path) -> tuple[int, str]:
    """Return the status of a command, and what it showed."""
    result = piezoid(*words)
    return result.exit_code, result.output


def started(*words: str | Path, place: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own and in a folder."""
    return subprocess.run(
        [*PIEZOID, *map(str, words)],
        cwd=place,
        env={**os.environ, "COLUMNS": "4000"},
        capture_output=True,
        text=True,
        check=False,
    )
