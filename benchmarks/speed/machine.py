"""Loops written in C for this processor, and chains of min and max in registers."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.loops import zones_of
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

FOLDER = Path(__file__).parent
PLAYS = 16  # as in the C source
NO_COMPILER = "There is no C compiler called cc, so loops in C are missing."


def has_compiler() -> bool:
    """Return whether there is a C compiler."""
    return shutil.which("cc") is not None


@cache
def _compiled(name: str, *options: str) -> ctypes.CDLL:
    """Compile a source for this processor.

    The linker must not see -ffast-math: such a library rounds subnormal numbers of the whole
    process to zero.
    """
    with tempfile.TemporaryDirectory() as folder:
        object_file, library = Path(folder) / f"{name}.o", Path(folder) / f"{name}.so"
        source = str(FOLDER / f"{name}.c")
        flags = ("-std=c99", "-O3", "-march=native", *options, "-c", "-fPIC")
        subprocess.run(["cc", *flags, source, "-o", str(object_file)], check=True)
        subprocess.run(["cc", "-shared", str(object_file), "-o", str(library)], check=True)
        return ctypes.CDLL(str(library))


def chains(u: Array, threshold: Array) -> Callable[[], Array] | None:
    """Return a function that computes the last states of 16 plays, or None without a compiler."""
    if not has_compiler():
        return None
    library = _compiled("chains", "-ffp-contract=off")

    def work() -> Array:
        state = np.zeros(PLAYS)
        _call(library.chains, len(u), u, threshold, state)
        return state

    return work


def c_bank(u: Array, threshold: Array) -> Array | None:
    """Return the states of the plays row by row, by a loop in C; None without a compiler."""
    if not has_compiler():
        return None
    plays = len(threshold)
    rows = np.empty((len(u), plays))
    _call(_loops().bank, len(u), u, plays, threshold, np.zeros(plays), rows)
    return rows


def c_forward(u: Array, model: ModifiedPrandtlIshlinskii) -> Array | None:
    """Return the model's displacement by a loop in C; None without a compiler."""
    if not has_compiler():
        return None
    memory = np.array(model.virgin_memory())
    return _mapped(_loops().forward, u, model.plays, memory, model.dead_zones)


def c_inverse(y: Array, model: ModifiedPrandtlIshlinskii) -> Array | None:
    """Return the voltage of a displacement by a loop in C; None without a compiler."""
    if not has_compiler():
        return None
    memory = np.array(model.plays.inverse_memory(model.virgin_memory()))
    return _mapped(_loops().inverse, y, model.plays.inverse(), memory, model.dead_zones.inverse())


def _loops() -> ctypes.CDLL:
    return _compiled("loops", "-ffast-math")


def _mapped(
    loop: Any, values: Array, plays: PrandtlIshlinskii, memory: Array, zones: DeadZones
) -> Array:
    output, (knot, weight, zero) = np.empty(len(values)), zones_of(zones)
    bank = len(memory), plays.threshold, plays.weight, memory
    _call(loop, len(values), values, *bank, len(knot), knot, weight, zero, output)
    return output


def _call(function: Any, *arguments: Array | int) -> None:
    """Call a C function with arrays as addresses and numbers as sizes."""
    function(
        *(
            ctypes.c_size_t(value)
            if isinstance(value, int)
            else ctypes.c_void_p(value.ctypes.data)
            for value in arguments
        )
    )
