"""Convert records to JSON values and back exactly, by the types of their fields.

A frozen record becomes a table of its fields, an array or tuple a list, an enumeration its value.
If the layout of a file differs from its record, a ``RecordLayout`` defines it. An infinite number
is written as null, because JSON has no infinity.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from math import inf, isinf
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np
from msgspec import ValidationError, convert

from piezoid.digests import unseal
from piezoid.errors import ParameterFileError

Record = TypeVar("Record")
_WRONG = (
    ValidationError, LookupError, ArithmeticError, TypeError, ValueError, AttributeError,
)  # fmt: skip
Unbounded = Annotated[float, "null where infinite"]
Interval = tuple[Unbounded, Unbounded]


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordLayout:
    """JSON layout of the records of one class and its subclasses.

    write  record -> table of JSON values or of further records
    read   table -> record; None reads the table field by field
    """

    kind: type
    write: Callable[[Any], Mapping[str, Any]]
    read: Callable[[Any], Any] | None = None


def to_json(
    value: Any, layouts: Sequence[RecordLayout] = (), *, may_be_infinite: bool = False
) -> Any:
    """Convert a record, an array, or a container of these to JSON values.

    An infinite number becomes None if the type of its field allows infinity or None; otherwise
    ``seal`` refuses it.

    may_be_infinite  whether the field of the value allows infinity or None
    """
    layout = next((candidate for candidate in layouts if isinstance(value, candidate.kind)), None)
    if layout is not None:
        return to_json(layout.write(value), layouts)
    if is_dataclass(value) and not isinstance(value, type):
        hints = _hints(type(value))
        return {
            name: to_json(item, layouts, may_be_infinite=_may_be_infinite(hints[name]))
            for name, item in fields_of(value).items()
        }
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, tuple | list):
        return [to_json(item, layouts, may_be_infinite=may_be_infinite) for item in value]
    if isinstance(value, Mapping):
        return {
            name: to_json(item, layouts, may_be_infinite=may_be_infinite)
            for name, item in value.items()
        }
    if isinstance(value, Enum):
        return value.value
    return None if may_be_infinite and isinstance(value, float) and isinf(value) else value


def fields_of(record: Any) -> dict[str, Any]:
    """Return the fields of a record by name, without conversion."""
    return {field.name: getattr(record, field.name) for field in fields(record)}


def from_json(kind: type[Record], value: Any, layouts: Sequence[RecordLayout] = ()) -> Record:
    """Rebuild a record from the result of ``to_json``; raises the errors of ``from_fields``."""
    return cast(Record, _read(kind, value, layouts, ""))


def from_fields(
    kind: type[Record], value: Any, layouts: Sequence[RecordLayout] = (), path: str = ""
) -> Record:
    """Build a record from a table of its fields, without the layout of its class.

    A field with a default may be missing, because earlier versions did not write it. Entries for
    properties of the class are ignored.

    Raises ``ValueError`` with the path of the entry for any other missing or unknown name, and for
    a value of a wrong type; ``path`` is the path of the table.
    """
    table = _leaf(dict[str, Any], value, path)
    by_name = {field.name: field for field in fields(cast(Any, kind))}
    needed = {
        name
        for name, field in by_name.items()
        if field.default is MISSING and field.default_factory is MISSING
    }
    unknown = {name for name in table if name not in by_name and not hasattr(kind, name)}
    if unknown or not needed <= set(table):
        raise ValueError(
            f"{path or 'the top'}: the fields are {sorted(table)}, not {sorted(by_name)}"
        )
    hints = _hints(cast(Any, kind))
    return kind(
        **{
            name: _read(hints[name], item, layouts, f"{path}.{name}")
            for name, item in table.items()
            if name in by_name
        }
    )


def read_sealed(
    kind: type[Record],
    content: bytes,
    schema: str,
    file: str,
    *,
    remedy: str,
    layouts: Sequence[RecordLayout] = (),
) -> Record:
    """Return the record of a sealed file.

    Raises ``ParameterFileError`` for a wrong digest, another schema, and missing or unknown
    entries or entries of a wrong type; ``remedy`` applies to wrong entries.
    """
    record = unseal(content, schema, file)
    content_entries = {
        name: value for name, value in record.items() if name not in ("schema", "digest")
    }
    with refusing(schema, file, remedy=remedy):
        return from_json(kind, content_entries, layouts)


@contextmanager
def refusing(schema: str, file: str, *, remedy: str) -> Iterator[None]:
    """Convert errors in entries of a file to ``ParameterFileError``."""
    try:
        yield
    except _WRONG as error:
        raise ParameterFileError(
            f"{file}: {type(error).__name__} at {error}",
            needed=f"every entry of schema {schema}, with its type",
            remedy=remedy,
        ) from error


def _read(kind: Any, value: Any, layouts: Sequence[RecordLayout], path: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        inner = next(argument for argument in arguments if argument is not NoneType)
        return None if value is None else _read(inner, value, layouts, path)
    if kind == Unbounded:
        return inf if value is None else _leaf(float, value, path)
    if origin is tuple:
        values = _leaf(list[Any], value, path)
        kinds = arguments[:1] * len(values) if arguments[-1] is Ellipsis else arguments
        if len(kinds) != len(values):
            raise ValueError(f"{path}: {len(values)} values, expected {len(kinds)}")
        pairs = enumerate(zip(kinds, values, strict=True))
        return tuple(_read(inner, item, layouts, f"{path}[{k}]") for k, (inner, item) in pairs)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        table = _leaf(dict[str, Any], value, path)
        return {k: _read(arguments[1], item, layouts, f"{path}.{k}") for k, item in table.items()}
    if origin is np.ndarray:
        return np.array(value, dtype=np.float64)
    if not is_dataclass(kind):
        return _leaf(kind, value, path)
    layout = next(
        (candidate for candidate in layouts if issubclass(cast(type, kind), candidate.kind)), None
    )
    if layout is not None and layout.read is not None:
        return layout.read(value)
    return from_fields(cast(type, kind), value, layouts, path)


def _leaf(kind: Any, value: Any, path: str) -> Any:
    try:
        return convert(value, kind)
    except ValidationError as error:
        raise ValueError(f"{path or 'the top'}: {error}") from error


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


@cache
def _may_be_infinite(hint: Any) -> bool:
    if hint == Unbounded or (float in get_args(hint) and NoneType in get_args(hint)):
        return True
    return any(_may_be_infinite(inner) for inner in get_args(hint))
