"""ParameterFile: the runtime parameters of every axis, from which all later steps start.

Header, bundle, verification and report use this record, so that all of them have the numbers that
ship.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piezoid import record_json
from piezoid.digests import digest_in, seal
from piezoid.errors import ParameterFileError
from piezoid.numerics.arrays import Array, expect_shapes, freeze
from piezoid.record_json import RecordLayout
from piezoid.runtime.library import PRECISIONS, SEALED, Values, complete, library
from piezoid.runtime.schema import METHODS, PARAMETERS, SCHEMA, Parameter

# Parameters that only files of plays behind functions contain.
FUNCTIONS = frozenset({"edge_count", "edge_steps", "edge_V", "play_value_m"})

# Parameters in a file: all but size and checksum, which depend on precision.
_SHIPPED = tuple(p for p in PARAMETERS if p.name not in SEALED)

# Names that are valid in C enumerators and in file names.
_AXIS = re.compile(r"[a-z][a-z0-9_]{0,15}")


@dataclass(frozen=True, kw_only=True)
class Robustness:
    """Margins and guaranteed error of the loop that ships, over its whole plant family.

    delay_margin_s          smallest additional delay that destabilises a plant; None: none does
    transient_s             time in which an error decays to 1 %, by the slowest closed-loop pole
    guaranteed_error_m      None without a useful bound
    reference_slew_m_per_s  fastest reference for which this bound holds; 0 without a bound
    """

    delay_margin_s: float | None
    transient_s: float
    guaranteed_error_m: float | None
    reference_slew_m_per_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisParameters:
    """All runtime parameters of one axis.

    axis          short lower-case name, ``x``
    values        that ship, by name, in the schema's order, full shapes, read-only
    alternatives  values of other methods, for comparison; each method once
    robustness    of the loop that ships; None in files of earlier versions, and for other values
    """

    axis: str
    values: Values
    alternatives: tuple[Values, ...] = ()
    robustness: Robustness | None = None

    def __post_init__(self) -> None:
        if not _AXIS.fullmatch(self.axis):
            raise ParameterFileError(
                f"an axis is named {self.axis!r}",
                needed="a letter, then at most 15 letters, digits or underscores, lower case",
                remedy="Rename the axis in lab.toml.",
            )
        object.__setattr__(self, "values", complete(self.values))
        object.__setattr__(self, "alternatives", tuple(map(complete, self.alternatives)))
        for values, precision in product((self.values, *self.alternatives), PRECISIONS):
            library(precision).pack(values)
        if len(set(self.methods)) != len(self.methods):
            raise ParameterFileError(
                f"axis {self.axis} has two controllers of the same method",
                needed="one controller for each method",
                remedy="Omit one of them.",
            )

    @property
    def method(self) -> str:
        """Control method of this axis, one of ``METHODS``."""
        return method_of(self.values)

    @property
    def is_tip(self) -> bool:
        """Whether the axis regulates the current of a tip."""
        return self.method == "rst"

    @property
    def sampling_rate_Hz(self) -> float:
        """Samples per second of the controller."""
        return float(self.values["sampling_rate_Hz"])

    @property
    def voltage_range_V(self) -> tuple[float, float]:
        """Lowest and highest output of the controller."""
        low, high = (self.values[f"voltage_{end}_V"] for end in ("minimum", "maximum"))
        return float(low), float(high)

    @property
    def methods(self) -> tuple[str, ...]:
        """The method that ships, then the alternatives."""
        return (self.method, *map(method_of, self.alternatives))

    def for_method(self, method: str) -> "AxisParameters":
        """Return the axis with another of its methods as the one that ships.

        Raises ``ParameterFileError`` for a method without a controller.
        """
        for values in (self.values, *self.alternatives):
            if method_of(values) == method:
                return AxisParameters(axis=self.axis, values=values)
        raise ParameterFileError(
            f"axis {self.axis} has no controller of method {method!r}",
            needed=f"one of {', '.join(self.methods)}",
            remedy="Design and export that method as well.",
        )

    def with_values(self, changed: Mapping[str, ArrayLike | str]) -> "AxisParameters":
        """Return the axis with some of the values that ship replaced, and validated.

        The margins of the exported loop need not hold for other values, and are left out.
        """
        return replace(self, values=complete({**self.values, **changed}), robustness=None)


def method_of(values: Values) -> str:
    """Return the name of the method of a set of values, one of ``METHODS``."""
    return METHODS[int(values["method"])]


@dataclass(frozen=True, kw_only=True, eq=False)
class Decoupled:
    """Matrix that multiplies references and readings in front of the controllers.

        r' = D r,  y' = D y

    axes    names, in the order of rows and columns; all of these displacements must be measured
    matrix  (axes, axes)  D
    """

    axes: tuple[str, ...]
    matrix: Array

    def __post_init__(self) -> None:
        freeze(self, "matrix", ndim=2)
        expect_shapes(self, {"matrix": (len(self.axes), len(self.axes))})


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterFile:
    """The shipped parameters of a stage.

    name       of the stage, any text
    axes       at least one, with different names, each valid for the runtime in both precisions
    sources    digests of the records from which it was made: ``model``, ``design``, ...
    unshipped  reason of each axis that does not ship, by axis
    decoupled  of axes whose drives act on all of their displacements; None: no matrix
    """

    name: str
    axes: tuple[AxisParameters, ...]
    sources: Mapping[str, str] = field(default_factory=dict)
    unshipped: Mapping[str, str] = field(default_factory=dict)
    decoupled: Decoupled | None = None

    def __post_init__(self) -> None:
        names = [axis.axis for axis in self.axes]
        if not names or len(set(names)) != len(names):
            raise ParameterFileError(
                f"the axes are {names}",
                needed="at least one axis, with different names",
                remedy="Give every axis of the stage one controller.",
            )

    def axis(self, name: str) -> AxisParameters:
        """Return the axis of a name; raises ``ParameterFileError`` if there is none.

        >>> shipping.parameters.axis("x").method
        'mpi_dob'
        """
        for axis in self.axes:
            if axis.axis == name:
                return axis
        raise ParameterFileError(
            f"no parameters for axis {name!r}",
            needed=f"one of {', '.join(axis.axis for axis in self.axes)}",
            remedy="Export that axis as well, or name one of these.",
        )


def _axis_entry(axis: AxisParameters) -> dict[str, Any]:
    alternatives = [
        {"method": method_of(values), "parameters": _entries(values)}
        for values in axis.alternatives
    ]
    robustness = {} if axis.robustness is None else {"robustness": axis.robustness}
    return {
        "axis": axis.axis,
        "method": axis.method,
        "parameters": _entries(axis.values),
        "alternatives": alternatives,
        **robustness,
    }


def _axis_of_entry(entry: Mapping[str, Any]) -> AxisParameters:
    robustness = entry.get("robustness")
    return AxisParameters(
        axis=entry["axis"],
        values=_values(entry["parameters"]),
        alternatives=tuple(_values(method["parameters"]) for method in entry["alternatives"]),
        robustness=None if robustness is None else record_json.from_json(Robustness, robustness),
    )


# The entries of params.json, in their order.
_ENTRIES = ("name", "sources", "unshipped", "decoupled", "axes")
LAYOUTS: tuple[RecordLayout, ...] = (
    RecordLayout(kind=AxisParameters, write=_axis_entry, read=_axis_of_entry),
    RecordLayout(
        kind=ParameterFile,
        write=lambda file: {
            name: value
            for name in _ENTRIES
            if (value := getattr(file, name)) is not None  # of ``decoupled``
        },
        read=lambda table: record_json.from_fields(
            ParameterFile, {name: table[name] for name in _ENTRIES if name in table}, LAYOUTS
        ),
    ),
)


def to_json(file: ParameterFile) -> bytes:
    """Return ``params.json``: sealed, one entry per parameter with its unit and meaning."""
    return seal(SCHEMA, record_json.to_json(file, LAYOUTS))


def digest_of(file: ParameterFile) -> str:
    """Return the digest in ``params.json`` of a parameter file."""
    return digest_in(to_json(file))


def from_json(content: bytes, source: str) -> ParameterFile:
    """Read ``params.json``, exactly.

    content  the file's bytes
    source   the file's name, for messages

    Raises ``ParameterFileError`` for another schema version, one changed bit, a missing or unknown
    parameter, another unit, and numbers that the runtime cannot use.
    """
    remedy = "Export the parameters again with this version of piezoid."
    return record_json.read_sealed(
        ParameterFile, content, SCHEMA, source, remedy=remedy, layouts=LAYOUTS
    )


def _entries(values: Values) -> dict[str, Any]:
    has_functions = values["edge_count"] != 0  # else as in files of earlier versions
    return {
        p.name: {
            "unit": p.unit,
            "value": used_values(p, values[p.name]).tolist(),
            "meaning": p.meaning,
        }
        for p in _SHIPPED
        if has_functions or p.name not in FUNCTIONS
    }


def used_values(parameter: Parameter, value: Array) -> Any:
    """Return an array without its trailing zeros along each dimension, or a scalar as it is."""
    numbers = value.astype(np.int64) if parameter.kind == "integer" else value
    if not parameter.shape:
        return numbers
    nonzero = np.argwhere(value != 0.0)
    extent = nonzero.max(axis=0) + 1 if len(nonzero) else np.zeros(value.ndim, dtype=np.int64)
    return numbers[tuple(slice(int(n)) for n in extent)]


def _values(entries: Mapping[str, Any]) -> Values:
    expected = {p.name: p.unit for p in _SHIPPED}
    units = {name: entry["unit"] for name, entry in entries.items()}
    if not units.keys() & FUNCTIONS:
        expected = {name: unit for name, unit in expected.items() if name not in FUNCTIONS}
    if units != expected:
        name, unit = sorted(set(units.items()) ^ set(expected.items()))[0]
        raise ValueError(f"{name} in {unit!r}, which is not the schema's")
    arrays = {}
    for name in expected:
        try:
            array = np.asarray(entries[name]["value"], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name}, which holds no numbers") from error
        if array.size:
            arrays[name] = array
    return complete(arrays)
