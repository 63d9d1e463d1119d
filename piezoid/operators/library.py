"""Compiled kernels: loaded once, with argument types for each function."""

import ctypes

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.numerics.compiled import opened

_SIZE = ctypes.c_size_t
_DOUBLE = ctypes.c_double
_INT = ctypes.c_int
_POINTER = ctypes.c_void_p

_SIGNATURES: dict[str, tuple[type, ...]] = {
    "pk_play_columns": (_SIZE, _POINTER, _SIZE, _POINTER, _POINTER, _SIZE, _POINTER),
    "pk_play_sum": (_SIZE, _POINTER, _SIZE, *[_POINTER] * 4),
    "pk_piecewise_linear": (_SIZE, *[_POINTER] * 4),
    "pk_mapped_plays": (
        *(_SIZE, _POINTER, _DOUBLE, _POINTER),
        *(_SIZE, *[_POINTER] * 3),
        *(_POINTER, _DOUBLE, _POINTER),
    ),
    "pk_valued_inverse": (
        *(_SIZE, _POINTER, _SIZE, _DOUBLE),
        *(_SIZE, *[_POINTER] * 4),
    ),
    "pk_chain_rows": (
        *(_INT, _SIZE),
        *[_POINTER] * 3,
        *(_SIZE, *[_POINTER] * 3),
        *(_SIZE, *[_POINTER] * 2),
    ),
    "pk_ladder": (_SIZE, _POINTER, _SIZE, *[_POINTER] * 5),
    "pk_slew": (_SIZE, _POINTER, _DOUBLE, _POINTER),
    "pk_bouc_wen": (_SIZE, _POINTER, _SIZE, _POINTER, _DOUBLE, *[_POINTER] * 2),
    "pk_friction": (_SIZE, _POINTER, _SIZE, *[_POINTER] * 4, _SIZE, _POINTER),
    "pk_polynomials": (_SIZE, _POINTER, _SIZE, _SIZE, *[_POINTER] * 5),
    "pk_activated": (_SIZE, _POINTER, _DOUBLE, _DOUBLE, _POINTER),
}


KERNELS = opened(
    "piezoid.operators._kernels", {name: (None, takes) for name, takes in _SIGNATURES.items()}
)


def address(array: Array | None) -> ctypes.c_void_p | None:
    """Return the address of a contiguous float64 array for a kernel; None gives NULL.

    The pointer keeps the array alive, so a temporary copy may be passed.
    """
    if array is None:
        return None
    if array.dtype != np.float64 or not array.flags.forc:
        raise TypeError(f"a kernel needs contiguous float64, not {array.dtype}")
    pointer = _POINTER(array.__array_interface__["data"][0])
    pointer.array = array  # type: ignore[attr-defined]
    return pointer


def contiguous(values: Array) -> Array:
    """Return ``values`` as a contiguous float64 vector, copied only if it is not one."""
    return np.ascontiguousarray(values, dtype=np.float64)
