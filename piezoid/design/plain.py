"""Records to JSON values and back, exactly: the field types say how."""

import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from piezoid.errors import ParameterFileError

Record = TypeVar("Record")

_KINDS: dict[Any, tuple[type, ...]] = {
    float: (float, int), int: (int,), bool: (bool,), str: (str,),
}  # fmt: skip


def to_plain(value: Any) -> Any:
    """Return a record, array, tuple or number as what ``json`` writes.

    Infinite numbers become None: JSON has no word for them, and every field that can be infinite
    says so in its type.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: to_plain(item) for key, item in value.items()}
    return value


def from_plain(kind: type[Record], value: Any, place: str) -> Record:
    """Build a record from what ``to_plain`` made of it.

    kind   a dataclass; its annotations are followed
    place  the path inside the file, for the message

    A field with a default may be missing: an earlier version did not know it.

    Raises ``ParameterFileError`` for any other missing field, and for an unknown one; and
    ``ValueError`` for a value of another kind.
    """
    hints = get_type_hints(kind)
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    needed = {
        name
        for name, field in known.items()
        if field.default is MISSING and field.default_factory is MISSING
    }
    if not isinstance(value, dict) or not needed <= set(value) <= set(known):
        found = sorted(value) if isinstance(value, dict) else type(value).__name__
        raise ParameterFileError(
            f"{place}: the fields are {found}",
            needed=f"exactly {sorted(known)}",
            remedy="Write the file again with this version of piezoid.",
        )
    return kind(**{name: _read(hints[name], value[name], f"{place}.{name}") for name in value})


def _read(kind: Any, value: Any, place: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        inner = next(argument for argument in arguments if argument is not type(None))
        return None if value is None else _read(inner, value, place)
    if origin is tuple:
        return tuple(_read(arguments[0], item, f"{place}[{k}]") for k, item in enumerate(value))
    if origin is dict:
        return {key: _read(arguments[1], item, f"{place}.{key}") for key, item in value.items()}
    if origin is np.ndarray:
        return np.array(value, dtype=np.float64)
    if isinstance(kind, type) and is_dataclass(kind):
        return from_plain(kind, value, place)
    if kind in _KINDS and type(value) not in _KINDS[kind]:
        raise ValueError(f"{place}, which is {type(value).__name__}, not {kind.__name__}")
    return value
