"""Calls of the command line, in this process and in another."""

import subprocess
import sys
from pathlib import Path

from click.testing import Result
from typer.testing import CliRunner

from piezoid_cli.main import app


def invoke(*words: object, columns: int = 200) -> Result:
    """Call a verb in this process, in a terminal of this width."""
    return CliRunner(env={"COLUMNS": str(columns)}).invoke(app, [str(word) for word in words])


def run_module(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run the command line in another process that starts in a folder."""
    command = [sys.executable, "-m", "piezoid_cli.main", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
