"""MATLAB files, version 5 to 7.3: vectors of the workspace, or of the fields of a structure."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from piezoid.records.readers.foreign import reading, table_of
from piezoid.records.readers.hdf5 import check_datasets
from piezoid.records.readers.hdf5_trees import SIGNATURE
from piezoid.records.readers.matlab_growth import check_matlab_growth
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_growth, unreadable
from piezoid.records.recording import Problem
from piezoid.records.table import RawTable

# What SciPy makes of an object: its name, MCOS, its class, and numbers of its bookkeeping.
_OBJECT = frozenset({"s0", "s1", "s2", "arr"})
_PLAIN = frozenset({"char", "cell", "struct", "logical", "double", "single", "function_handle"})
_SAVE = (
    "In MATLAB, save columns as vectors (time_s = seconds(T.Time); voltage_V = T.Voltage), or "
    "write the table with writetable or writetimetable as CSV."
)


def recognises(source: Source) -> bool:
    """Tell it by the text every such file starts with; version 7.3 is HDF5 behind 512 bytes."""
    is_bare_hdf5 = source.head.startswith(SIGNATURE) and source.suffix == ".mat"
    return source.head.startswith(b"MATLAB ") or is_bare_hdf5


def read(source: Source) -> RawTable:
    """Read every numeric vector, by the name of its variable or ``structure.field``."""
    if source.unpacked is not None:
        raise unreadable(
            source.name,
            "it is a compressed MATLAB file",
            needed="the .mat file itself",
            remedy="Run: gunzip " + source.name,
        )
    with reading(source, "MATLAB"):
        from pymatreader import read_mat

        _check_sizes(source)
        opaque = {} if source.head.startswith(b"MATLAB 5") else _objects_of_hdf5(source)
        held = dict(_flat("", read_mat(str(source.path)), opaque))
        arrays = {name: value for name, value in held.items() if name not in opaque}
    said = ", ".join(f"{name!r} ({kind})" for name, kind in opaque.items())
    if opaque and not any(value.size > 1 for value in arrays.values()):
        raise unreadable(
            source.name,
            f"it holds objects that only MATLAB can open: {said}",
            needed="vectors of numbers, alone or in a structure",
            remedy=_SAVE,
        )
    table = table_of(source, "MATLAB", arrays)
    if not opaque:
        return table
    text = f"{said} are objects that only MATLAB can open, and are not read. {_SAVE}"
    problem = Problem(kind="opaque", place=next(iter(opaque)), text=text)
    return replace(table, problems=(problem, *table.problems))


def _check_sizes(source: Source) -> None:
    """Refuse what would not fit into memory by the sizes declared, before anything is read."""
    if source.head.startswith(b"MATLAB 5"):
        from scipy.io import whosmat

        # An object has no size to tell, at which SciPy stumbles; what is in the file is counted.
        with suppress(TypeError):
            found = whosmat(str(source.path))
            check_growth(source, 8 * sum(int(np.prod(s, dtype=object)) for _, s, _ in found))
        check_matlab_growth(source)
    else:
        check_datasets(source)


def _objects_of_hdf5(source: Source) -> dict[str, str]:
    """Return the class of every object: what is in its place are numbers of its bookkeeping."""
    import h5py

    found: dict[str, str] = {}

    def keep(path: str, item: Any) -> None:
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)
        if "MATLAB_object_decode" in item.attrs and kind not in _PLAIN and path[0] != "#":
            found[path.replace("/", ".")] = kind or "object"

    with source.open() as stream:
        h5py.File(stream, "r").visititems(keep)
    return found


def _flat(
    prefix: str, held: Mapping[str, object], opaque: dict[str, str]
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the variables, fields of structures by ``structure.field``; note what is an object."""
    for key, value in held.items():
        if str(key).startswith(("__", "#")):
            continue
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping) and set(value) >= _OBJECT:
            own, kind = (_word(value[field]) for field in ("s0", "s2"))
            opaque[own or name] = kind
        elif isinstance(value, Mapping):
            yield from _flat(name, value, opaque)
        else:
            yield name, value if isinstance(value, np.ndarray) else np.asarray(value)


def _word(held: object) -> str:
    """Return the one word in a field of an object."""
    word = held[0] if isinstance(held, list | tuple | np.ndarray) and len(held) else held
    return word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word)


READER = Reader(name="MATLAB", suffixes=(".mat",), recognises=recognises, read=read)
