"""The compiled runtime, seen from Python: opened in either precision, its layout compared."""

import ctypes
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from piezoid.errors import ParameterFileError, RuntimeLibraryError
from piezoid.numerics.arrays import Array
from piezoid.runtime.schema import PARAMETERS, VERSION, Parameter, structure
from piezoid.runtime.values import SEALED, Values

PRECISIONS = {
    "double": ("piezoid.runtime._runtime", ctypes.c_double),
    "float": ("piezoid.runtime._runtime32", ctypes.c_float),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Library:
    """One build of the shipped source.

    precision   ``double`` or ``float``
    code        the opened library
    real        ctypes' number of that precision
    parameters  the mirror of ``pz_parameters``
    state_size  bytes of a ``pz_state``
    """

    precision: str
    code: ctypes.CDLL
    real: Any
    parameters: type[ctypes.Structure]
    state_size: int

    def pack(self, values: Values) -> ctypes.Structure:
        """Return the parameters as the runtime reads them, with size and checksum.

        Raises ``ParameterFileError`` naming the first one the runtime cannot use.
        """
        packed = self.parameters()
        for parameter in PARAMETERS:
            _write(packed, parameter, values[parameter.name])
        self.seal(packed)
        place = self.code.pz_check(ctypes.byref(packed))
        if place:
            unusable = PARAMETERS[place - 1]
            raise ParameterFileError(
                f"the runtime cannot use {unusable.name} ({unusable.meaning})",
                needed="a set of parameters that is invertible, stable and consistent",
                remedy="Design again, or compare with the conditions beside pz_check in "
                "piezoid_runtime.c.",
                parameter=unusable.name,
            )
        return packed

    def seal(self, packed: ctypes.Structure) -> None:
        """Write schema version, size and checksum into packed parameters."""
        checksum = self.code.pz_checksum(ctypes.byref(packed))
        sealed = (VERSION, ctypes.sizeof(self.parameters), checksum)
        for name, value in zip(SEALED, sealed, strict=True):
            setattr(packed, name, value)

    def log(self, x: float) -> float:
        """Return the runtime's own natural logarithm of a positive number."""
        return float(self.code.pz_log(x))


def _write(packed: ctypes.Structure, parameter: Parameter, value: Array) -> None:
    if parameter.shape:
        np.ctypeslib.as_array(getattr(packed, parameter.name))[...] = value
    else:
        number = float(value)
        setattr(packed, parameter.name, int(number) if parameter.kind == "integer" else number)


def _field(real: Any) -> type[ctypes.Structure]:
    members = [
        ("name", ctypes.c_char_p),
        ("offset_bytes", ctypes.c_size_t),
        ("count", ctypes.c_size_t),
        ("is_real", ctypes.c_int32),
        ("lower", real),
        ("upper", real),
    ]
    return type("Field", (ctypes.Structure,), {"_fields_": members})


@cache
def library(precision: str = "double") -> Library:
    """Open the runtime of this precision, or say what is wrong with it.

    precision  ``double`` or ``float``
    """
    name, real = PRECISIONS[precision]
    module = find_spec(name)
    if module is None or module.origin is None:
        raise RuntimeLibraryError(
            f"the compiled runtime {name} is not beside the package",
            needed="an installation that compiled it",
            remedy="Install piezoid with a C compiler present: pip install .",
        )
    code = ctypes.CDLL(module.origin)
    _declare(code, real)
    opened = Library(
        precision=precision,
        code=code,
        real=real,
        parameters=structure(real),
        state_size=code.pz_size_of_state(),
    )
    compare_layout(opened)
    return opened


def _declare(code: ctypes.CDLL, real: Any) -> None:
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    signatures: dict[str, tuple[Any, tuple[Any, ...]]] = {
        "pz_size_of_state": (size, ()),
        "pz_size_of_real": (size, ()),
        "pz_describe": (ctypes.POINTER(_field(real)), (ctypes.c_int32,)),
        "pz_checksum": (ctypes.c_uint32, (pointer,)),
        "pz_check": (ctypes.c_int32, (pointer,)),
        "pz_start": (ctypes.c_int32, (pointer, pointer, real, real)),
        "pz_schedule": (None, (pointer, pointer, real)),
        "pz_reset": (None, (pointer,)),
        "pz_step": (real, (pointer, pointer, real, real)),
        "pz_step_feedforward": (real, (pointer, pointer, real, real, real)),
        "pz_log": (real, (real,)),
        "pz_run_many": (None, (pointer, pointer, size, *[pointer] * 4)),
    }
    for name, (answer, arguments) in signatures.items():
        function = getattr(code, name)
        function.restype = answer
        function.argtypes = arguments


def compare_layout(opened: Library) -> None:
    """Raise ``RuntimeLibraryError`` unless the library's table is the schema's, line by line."""
    real_size = opened.code.pz_size_of_real()
    if real_size != ctypes.sizeof(opened.real):
        raise _other_layout("size of pz_real", real_size, ctypes.sizeof(opened.real))
    for index, parameter in enumerate(PARAMETERS, start=1):
        entry = opened.code.pz_describe(index)
        found = _of_library(entry.contents) if entry else None
        expected = _of_schema(opened, parameter.name, index)
        if found != expected:
            raise _other_layout(f"line {index} of the parameter table", found, expected)
    if opened.code.pz_describe(len(PARAMETERS) + 1):
        raise _other_layout("length of the parameter table", "longer", len(PARAMETERS))


def _of_library(entry: Any) -> tuple[object, ...]:
    return (
        entry.name.decode(),
        entry.offset_bytes,
        entry.count,
        bool(entry.is_real),
        entry.lower,
        entry.upper,
    )


def _of_schema(opened: Library, name: str, index: int) -> tuple[object, ...]:
    parameter = PARAMETERS[index - 1]
    size = ctypes.sizeof(opened.parameters)
    lower, upper = (size, size) if name == "size_bytes" else (parameter.lower, parameter.upper)
    return (
        name,
        getattr(opened.parameters, name).offset,
        parameter.count,
        parameter.kind == "real",
        opened.real(lower).value,
        opened.real(upper).value,
    )


def _other_layout(what: str, found: object, expected: object) -> RuntimeLibraryError:
    return RuntimeLibraryError(
        f"the compiled runtime is of another layout: {what} is {found}",
        needed=f"{expected}, as in piezoid.runtime.schema",
        remedy="Install piezoid again, so that the runtime is compiled from this source.",
    )
