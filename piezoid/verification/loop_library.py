"""The structures and functions of plant_loop.c in Python."""

import ctypes
from functools import cache
from typing import Any

from piezoid.numerics.compiled import opened

MAX_STATES = 64

RESPOND = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)


def _fields(kind: Any, names: str) -> tuple[tuple[str, Any], ...]:
    """Return members of one type, their names separated by spaces."""
    return tuple((name, kind) for name in names.split())


_SIZE, _POINTER, _REAL = ctypes.c_size_t, ctypes.c_void_p, ctypes.c_double


class Linear(ctypes.Structure):
    """``pl_linear``."""

    _fields_ = (
        *_fields(_SIZE, "states"),
        *_fields(_POINTER, "A B_old B_new C"),
        ("D", _REAL * 2),
        *_fields(_POINTER, "x"),
    )


class Map(ctypes.Structure):
    """``pl_map``."""

    _fields_ = (*_fields(_SIZE, "knots"), *_fields(_POINTER, "knot slope"), ("zero", _SIZE))


class LoopPlant(ctypes.Structure):
    """``pl_plant``."""

    _fields_ = (
        *_fields(_SIZE, "substeps late waited"),
        *_fields(_POINTER, "late_V"),
        *_fields(Linear, "before after"),
        *_fields(ctypes.c_int64, "kind"),
        *_fields(_SIZE, "plays"),
        *_fields(_POINTER, "threshold_V weight play_V"),
        *_fields(_SIZE, "edges"),
        *_fields(_POINTER, "edge_V value_m"),
        *_fields(Map, "envelope zones"),
        *_fields(_REAL, "low_V high_V activation_step activation_m irreversible_m"),
        *_fields(_SIZE, "second_plays second_powers"),
        *_fields(_POINTER, "second_threshold_V second_weight_m second_play_V"),
        *_fields(_REAL, "second_centre_V second_reach_V"),
        *_fields(_SIZE, "cyclic_orders"),
        *_fields(_POINTER, "cyclic_cosine_m cyclic_sine_m"),
        *_fields(_REAL, "cyclic_per_m"),
        *_fields(_REAL, "polarity voltage_offset_V displacement_offset_m current_A current_most"),
        ("respond", RESPOND),
        *_fields(_REAL, "slew_step driven w"),
        *_fields(_REAL, "reading_zero reading_lsb reading_least reading_most"),
    )


class LoopRun(ctypes.Structure):
    """``pl_run``."""

    _fields_ = (
        *_fields(_POINTER, "step_double step_float state parameters"),
        *_fields(_SIZE, "samples"),
        *_fields(_POINTER, "reference disturbance noise fault reset"),
        *_fields(_SIZE, "reset_at"),
        *_fields(_POINTER, "driven position measured voltage_V status"),
    )


@cache
def loop_library() -> ctypes.CDLL:
    """Open the compiled plant loop."""
    functions = {
        "pl_response": (_REAL, (_POINTER, _REAL, _REAL)),
        "pl_loop": (None, (_POINTER, _POINTER)),
    }
    return opened("piezoid.verification._plant_loop", functions)
