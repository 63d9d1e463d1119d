"""The compiled runtime: loaded in either precision, with its layout checked."""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import ParameterFileError, RuntimeLibraryError
from piezoid.numerics.arrays import Array
from piezoid.numerics.compiled import Signatures, opened
from piezoid.runtime.schema import INDEX, METHODS, PARAMETERS, VERSION, Parameter, structure

Values = Mapping[str, Array]

# Computed from the others when they are packed for one precision.
SEALED = ("schema", "size_bytes", "checksum")

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
            name, value = parameter.name, values[parameter.name]
            if parameter.shape:
                np.ctypeslib.as_array(getattr(packed, name))[...] = value
            else:
                setattr(packed, name, int(value) if parameter.kind == "integer" else float(value))
        self.seal(packed)
        number = self.code.pz_check(ctypes.byref(packed))
        if number:
            unusable = PARAMETERS[number - 1]
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


@cache
def library(precision: str = "double") -> Library:
    """Open the runtime of this precision and check its layout.

    precision  ``double`` or ``float``
    """
    name, real = PRECISIONS[precision]
    pointer, size, number = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int32
    members = [
        ("name", ctypes.c_char_p),
        ("offset_bytes", size),
        ("count", size),
        ("is_real", number),
        ("lower", real),
        ("upper", real),
    ]
    entry = type("Field", (ctypes.Structure,), {"_fields_": members})
    signatures: Signatures = {
        "pz_size_of_state": (size, ()),
        "pz_size_of_real": (size, ()),
        "pz_describe": (ctypes.POINTER(entry), (number,)),
        "pz_checksum": (ctypes.c_uint32, (pointer,)),
        "pz_check": (number, (pointer,)),
        "pz_start": (number, (pointer, pointer, real, real)),
        "pz_schedule": (None, (pointer, pointer, real)),
        "pz_reset": (None, (pointer,)),
        "pz_step": (real, (pointer, pointer, real, real)),
        "pz_step_feedforward": (real, (pointer, pointer, real, real, real)),
        "pz_log": (real, (real,)),
        "pz_run_many": (None, (pointer, pointer, size, *[pointer] * 4)),
    }
    code = opened(name, signatures)
    runtime = Library(
        precision=precision,
        code=code,
        real=real,
        parameters=structure(real),
        state_size=code.pz_size_of_state(),
    )
    compare_layout(runtime)
    return runtime


def compare_layout(opened: Library) -> None:
    """Raise ``RuntimeLibraryError`` unless the parameter table of the library is the schema."""
    real_size = opened.code.pz_size_of_real()
    if real_size != ctypes.sizeof(opened.real):
        raise _other_layout("size of pz_real", real_size, ctypes.sizeof(opened.real))
    for index, parameter in enumerate(PARAMETERS, start=1):
        actual = None
        if pointer := opened.code.pz_describe(index):
            entry = pointer.contents
            actual = (
                *(entry.name.decode(), entry.offset_bytes, entry.count, bool(entry.is_real)),
                *(entry.lower, entry.upper),
            )
        lower, upper = parameter.lower, parameter.upper
        if parameter.name == "size_bytes":
            lower = upper = ctypes.sizeof(opened.parameters)
        expected = (
            parameter.name,
            getattr(opened.parameters, parameter.name).offset,
            parameter.count,
            parameter.kind == "real",
            *(opened.real(lower).value, opened.real(upper).value),
        )
        if actual != expected:
            raise _other_layout(f"line {index} of the parameter table", actual, expected)
    if opened.code.pz_describe(len(PARAMETERS) + 1):
        raise _other_layout("length of the parameter table", "longer", len(PARAMETERS))


def _other_layout(what: str, actual: object, expected: object) -> RuntimeLibraryError:
    return RuntimeLibraryError(
        f"the compiled runtime is of another layout: {what} is {actual}",
        needed=f"{expected}, as in piezoid.runtime.schema",
        remedy="Install piezoid again, so that the runtime is compiled from this source.",
    )


def complete(parameters: Mapping[str, ArrayLike | str]) -> Values:
    """Return every parameter of the schema, padded to its full shape, read-only.

    parameters  by name; shorter arrays fill the first elements, one number fills all elements;
                ``method`` may be a name; missing parameters take the default of the schema
    returned    float64 arrays in the shapes and order of the schema

    Raises ``ParameterFileError`` for an unknown name, too many numbers, a fraction where an
    integer is needed, or a number outside its bounds.
    """
    unknown = sorted(set(parameters) - set(INDEX))
    if unknown:
        raise ParameterFileError(
            f"unknown parameter {unknown[0]!r}",
            needed=f"one of the {len(INDEX)} names of the schema",
            remedy="Compare the spelling with piezoid.runtime.schema.PARAMETERS.",
        )
    return {p.name: _padded(p, parameters.get(p.name, p.default)) for p in PARAMETERS}


def _padded(parameter: Parameter, value: ArrayLike | str) -> Array:
    if parameter.name == "method" and isinstance(value, str):
        value = METHODS.index(value) if value in METHODS else -1
    numbers = np.asarray(value, dtype=np.float64)
    padded = np.zeros(parameter.shape)
    if numbers.ndim == 0:
        padded[...] = numbers
    elif numbers.ndim != padded.ndim or any(
        n > m for n, m in zip(numbers.shape, padded.shape, strict=True)
    ):
        raise ParameterFileError(
            f"{parameter.name} has the shape {numbers.shape}",
            needed=f"at most {parameter.shape}",
            remedy="Reduce the model's order, or build the runtime with larger tables.",
        )
    else:
        padded[tuple(slice(n) for n in numbers.shape)] = numbers
    is_within = (padded >= parameter.lower) & (padded <= parameter.upper)
    if parameter.kind == "integer":
        is_within &= padded == np.floor(padded)
    if not is_within.all():
        worst = padded.ravel()[int(np.flatnonzero(~is_within.ravel())[0])]
        raise ParameterFileError(
            f"{parameter.name} is {worst:.9g} {parameter.unit} ({parameter.meaning})",
            needed=f"{parameter.kind} numbers from {parameter.lower:.9g} to {parameter.upper:.9g}",
            remedy="Check its unit: everything is in SI units.",
        )
    padded += 0.0  # turn -0.0 into 0.0, the value of elements that are not written
    padded.setflags(write=False)
    return padded
