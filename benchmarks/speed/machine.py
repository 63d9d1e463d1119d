"""What this very machine can do: loops by hand in C, and chains of min and max in registers."""

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
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

HERE = Path(__file__).parent
PLAYS = 16  # as in the source
NO_COMPILER = "There is no C compiler called cc: nothing is compared with loops in C."


def has_compiler() -> bool:
    """Return whether there is a C compiler."""
    return shutil.which("cc") is not None


@cache
def _compiled(name: str, *more: str) -> ctypes.CDLL:
    """Compile a source for this very processor.

    Linked by itself: a library linked with -ffast-math rounds subnormal numbers of the whole
    process to zero from the moment it is opened.
    """
    with tempfile.TemporaryDirectory() as folder:
        compiled, place = Path(folder) / f"{name}.o", Path(folder) / f"{name}.so"
        flags = ("-std=c99", "-O3", "-march=native", *more, "-c", "-fPIC")
        subprocess.run(["cc", *flags, str(HERE / f"{name}.c"), "-o", str(compiled)], check=True)
        subprocess.run(["cc", "-shared", str(compiled), "-o", str(place)], check=True)
        return ctypes.CDLL(str(place))


def chains(u: Array, threshold: Array) -> Callable[[], Array] | None:
    """Return work that leaves the last states of 16 plays, or None without a compiler."""
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
    """Return the voltage that makes this displacement by a loop in C; None without a compiler."""
    if not has_compiler():
        return None
    memory = np.array(model.plays.inverse_memory(model.virgin_memory()))
    return _mapped(_loops().inverse, y, model.plays.inverse(), memory, model.dead_zones.inverse())


def _loops() -> ctypes.CDLL:
    return _compiled("loops", "-ffast-math")


def _mapped(
    loop: Any, values: Array, plays: PrandtlIshlinskii, memory: Array, zones: DeadZones
) -> Array:
    made, (knot, weight, zero) = np.empty(len(values)), zones_of(zones)
    bank = len(memory), plays.threshold, plays.weight, memory
    _call(loop, len(values), values, *bank, len(knot), knot, weight, zero, made)
    return made


def _call(function: Any, *given: Array | int) -> None:
    """Call with arrays as addresses and numbers as sizes."""
    function(
        *(
            ctypes.c_size_t(one) if isinstance(one, int) else ctypes.c_void_p(one.ctypes.data)
            for one in given
        )
    )
