"""The command line, run in this process or in a separate process."""

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
    """Return exit status and output of a command."""
    result = piezoid(*words)
    return result.exit_code, result.output


def run_process(
    *words: str | Path, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command in a separate process, in a folder."""
    return subprocess.run(
        [*PIEZOID, *map(str, words)],
        cwd=folder,
        env={**os.environ, "COLUMNS": "4000"},
        capture_output=True,
        text=True,
        check=False,
    )
