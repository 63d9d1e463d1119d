"""From what somebody says about parameters to one complete, checked set of numbers."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from piezoid.errors import ParameterFileError
from piezoid.numerics.arrays import Array
from piezoid.runtime.schema import INDEX, METHODS, PARAMETERS, Parameter

Values = Mapping[str, Array]

# Computed from the others when they are packed for one precision.
SEALED = ("schema", "size_bytes", "checksum")


def complete(given: Mapping[str, ArrayLike | str]) -> Values:
    """Return every parameter of the schema, padded to its full shape, read-only.

    given     by name; arrays may be shorter than the schema's (they go into the first places), one
              number fills all places; ``method`` may be a name; whatever is missing takes the
              schema's default
    returned  float64 arrays of the schema's shapes, in the schema's order

    Raises ``ParameterFileError`` for an unknown name, too many numbers, a fraction where an
    integer is needed, or a number outside its bounds.
    """
    unknown = sorted(set(given) - set(INDEX))
    if unknown:
        raise ParameterFileError(
            f"unknown parameter {unknown[0]!r}",
            needed=f"one of the {len(INDEX)} names of the schema",
            remedy="Compare the spelling with piezoid.runtime.schema.PARAMETERS.",
        )
    return {p.name: _padded(p, given.get(p.name, p.default)) for p in PARAMETERS}


def _padded(parameter: Parameter, value: ArrayLike | str) -> Array:
    if parameter.name == "method" and isinstance(value, str):
        value = METHODS.index(value) if value in METHODS else -1
    numbers = np.asarray(value, dtype=np.float64)
    full = np.zeros(parameter.shape)
    if numbers.ndim == 0:
        full[...] = numbers
    elif numbers.ndim != full.ndim or any(
        n > m for n, m in zip(numbers.shape, full.shape, strict=True)
    ):
        raise ParameterFileError(
            f"{parameter.name} has the shape {numbers.shape}",
            needed=f"at most {parameter.shape}",
            remedy="Reduce the model's order, or build the runtime with larger tables.",
        )
    else:
        full[tuple(slice(n) for n in numbers.shape)] = numbers
    _within_bounds(parameter, full)
    full += 0.0  # a negative zero becomes a zero: what is not written is a zero too
    full.setflags(write=False)
    return full


def _within_bounds(parameter: Parameter, full: Array) -> None:
    good = (full >= parameter.lower) & (full <= parameter.upper)
    if parameter.kind == "integer":
        good &= full == np.floor(full)
    if not good.all():
        worst = full.ravel()[int(np.flatnonzero(~good.ravel())[0])]
        raise ParameterFileError(
            f"{parameter.name} is {worst:.9g} {parameter.unit} ({parameter.meaning})",
            needed=f"{parameter.kind} numbers from {parameter.lower:.9g} to {parameter.upper:.9g}",
            remedy="Check its unit: everything is in SI units.",
        )
