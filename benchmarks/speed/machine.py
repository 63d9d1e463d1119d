"""What this very machine can do at best: chains of minima and maxima in registers."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from piezoid.numerics.arrays import Array

SOURCE = Path(__file__).with_name("chains.c")
PLAYS = 16  # as in the source
NO_COMPILER = "There is no C compiler called cc: nothing is compared with chains of min and max."


def has_compiler() -> bool:
    """Return whether there is a C compiler."""
    return shutil.which("cc") is not None


@cache
def _compiled() -> ctypes.CDLL:
    """Compile the chains for this very processor."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "chains.so"
        flags = ("-std=c99", "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC")
        subprocess.run(["cc", *flags, str(SOURCE), "-o", str(place)], check=True)
        return ctypes.CDLL(str(place))


def chains(u: Array, threshold: Array) -> Callable[[], Array] | None:
    """Return work that leaves the last states of 16 plays, or None without a compiler."""
    if not has_compiler():
        return None
    library = _compiled()

    def work() -> Array:
        state = np.zeros(PLAYS)
        address = (ctypes.c_void_p(a.ctypes.data) for a in (u, threshold, state))
        library.chains(ctypes.c_size_t(len(u)), *address)
        return state

    return work
