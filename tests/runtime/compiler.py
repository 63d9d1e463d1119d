"""The machine's own C compiler on the shipped source, as a firmware engineer would call it."""

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


def found(*names):
    for name in names:
        if shutil.which(name):
            return name
    pytest.skip(f"no {names[0]} on this machine")


def run(*command, **arguments):
    """Run a program; a failure shows what it wrote."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def write_files(folder, files):
    """Write files by their names below a folder and return the folder."""
    for name, content in files.items():
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    return folder
