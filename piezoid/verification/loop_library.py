"""plant_loop.c, seen from Python: its structures, opened once."""

import ctypes
from functools import cache
from typing import Any

from piezoid.numerics.arrays import Array
from piezoid.numerics.compiled import opened

MAX_STATES = 64

RESPOND = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)


class Linear(ctypes.Structure):
    """``pl_linear``."""

    _fields_ = (
        ("states", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("A", "B_old", "B_new", "C")),
        ("D", ctypes.c_double * 2),
        ("x", ctypes.c_void_p),
    )


class Map(ctypes.Structure):
    """``pl_map``."""

    _fields_ = (
        ("knots", ctypes.c_size_t),
        ("knot", ctypes.c_void_p),
        ("slope", ctypes.c_void_p),
        ("zero", ctypes.c_size_t),
    )


class LoopPlant(ctypes.Structure):
    """``pl_plant``."""

    _fields_ = (
        *((name, ctypes.c_size_t) for name in ("substeps", "late", "waited")),
        ("late_V", ctypes.c_void_p),
        ("before", Linear),
        ("after", Linear),
        ("kind", ctypes.c_int64),
        ("plays", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("threshold_V", "weight", "play_V")),
        ("edges", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("edge_V", "value_m")),
        ("envelope", Map),
        ("zones", Map),
        *(
            (name, ctypes.c_double)
            for name in ("low_V", "high_V", "activation_step", "activation_m", "irreversible_m")
        ),
        *((name, ctypes.c_size_t) for name in ("second_plays", "second_powers")),
        *(
            (name, ctypes.c_void_p)
            for name in ("second_threshold_V", "second_weight_m", "second_play_V")
        ),
        *((name, ctypes.c_double) for name in ("second_centre_V", "second_reach_V")),
        ("cyclic_orders", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("cyclic_cosine_m", "cyclic_sine_m")),
        ("cyclic_per_m", ctypes.c_double),
        *(
            (name, ctypes.c_double)
            for name in (
                "polarity",
                "voltage_offset_V",
                "displacement_offset_m",
                "current_A",
                "current_most",
            )
        ),
        ("respond", RESPOND),
        *(
            (name, ctypes.c_double)
            for name in (
                "slew_step",
                "driven",
                "w",
                "reading_zero",
                "reading_lsb",
                "reading_least",
                "reading_most",
            )
        ),
    )


class LoopRun(ctypes.Structure):
    """``pl_run``."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("step_double", "step_float")),
        *((name, ctypes.c_void_p) for name in ("state", "parameters")),
        ("samples", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("reference", "disturbance", "noise", "fault")),
        ("reset", ctypes.c_void_p),
        ("reset_at", ctypes.c_size_t),
        *(
            (name, ctypes.c_void_p)
            for name in ("driven", "position", "measured", "voltage_V", "status")
        ),
    )


@cache
def loop_library() -> ctypes.CDLL:
    """Open the compiled plant loop."""
    pointer, number = ctypes.c_void_p, ctypes.c_double
    return opened(
        "piezoid.verification._plant_loop",
        {
            "pl_response": (number, (pointer, number, number)),
            "pl_loop": (None, (pointer, pointer)),
        },
    )


class ArrayOwner:
    """Arrays a structure points to, kept alive with it."""

    def __init__(self) -> None:
        self.arrays: list[Any] = []

    def address(self, array: Array) -> int:
        """Return the address of an array, and hold it."""
        self.arrays.append(array)
        return int(array.ctypes.data)
