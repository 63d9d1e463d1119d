"""Calls of the installed C compiler on the shipped source, as a firmware engineer makes them."""

import shutil
import subprocess
from pathlib import Path

import pytest

import piezoid.runtime

SOURCE = Path(piezoid.runtime.__file__).parent
STRICT = (
    *("-std=c99", "-O2", "-ffp-contract=off", "-pedantic", "-Wall", "-Wextra", "-Werror"),
    *("-Wconversion", "-Wfloat-equal", "-Wdouble-promotion"),
)
PRECISION = {"double": (), "float": ("-DPZ_REAL_FLOAT",)}


def require_tool(*names):
    for name in names:
        if shutil.which(name):
            return name
    pytest.skip(f"no {names[0]} on this machine")


def attempt(*command, **arguments):
    """Run a program and return its exit code and outputs."""
    return subprocess.run(command, capture_output=True, text=True, check=False, **arguments)


def run(*command, **arguments):
    """Run a program that must succeed; a failure shows its outputs."""
    result = attempt(*command, **arguments)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def write_files(folder, files):
    """Write files by their names below a folder and return the folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder
