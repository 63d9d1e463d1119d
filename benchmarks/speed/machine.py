"""Chains of min and max in registers, in C for this processor."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from piezoid.numerics.arrays import Array

SOURCE = Path(__file__).with_name("chains.c")
FLAGS = ("-std=c99", "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC")
PLAYS = 16  # as in the C source
NO_COMPILER = "There is no C compiler called cc, so the chains of min and max are missing."


def has_compiler() -> bool:
    """Return whether there is a C compiler."""
    return shutil.which("cc") is not None


def chains(u: Array, threshold: Array) -> Callable[[], Array] | None:
    """Return a function that computes the last states of 16 plays, or None without a compiler."""
    if not has_compiler():
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chains.so"
        subprocess.run(["cc", *FLAGS, str(SOURCE), "-o", str(path)], check=True)
        library = ctypes.CDLL(str(path))

    def work() -> Array:
        state = np.zeros(PLAYS)
        arrays = (ctypes.c_void_p(values.ctypes.data) for values in (u, threshold, state))
        library.chains(ctypes.c_size_t(len(u)), *arrays)
        return state

    return work
