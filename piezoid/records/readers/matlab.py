"""MATLAB files, version 5 to 7.3: vectors of the workspace, or of the fields of a structure."""

import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from piezoid.records.readers.hdf5 import SIGNATURE, checked_datasets
from piezoid.records.readers.named_arrays import table_of
from piezoid.records.readers.reader import Reader, Source, check_growth, unreadable
from piezoid.records.table import RawTable
from piezoid.statement import finding

# Fields of an object as read by SciPy: its name, MCOS, its class, and its internal numbers.
OBJECT_FIELDS = frozenset({"s0", "s1", "s2", "arr"})
PLAIN_CLASSES = frozenset(
    {"char", "cell", "struct", "logical", "double", "single", "function_handle"}
)
SAVING_ADVICE = (
    "In MATLAB, save columns as vectors (time_s = seconds(T.Time); voltage_V = T.Voltage), or "
    "write the table with writetable or writetimetable as CSV."
)
HEADER_SIZE = 128  # bytes in front of the elements of versions 5 to 7
COMPRESSED = 15  # type of an element that zlib compressed
PIECE_SIZE = 1 << 20


def read(source: Source) -> RawTable:
    """Read every numeric vector, by the name of its variable or ``structure.field``."""
    import h5py
    from pymatreader import read_mat

    if source.decompressed is not None:
        raise unreadable(
            source.name,
            "it is a compressed MATLAB file",
            needed="the .mat file itself",
            remedy="Run: gunzip " + source.name,
        )
    opaque: dict[str, str] = {}  # class of every object, by its path

    def note_object(path: str, item: Any) -> None:
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)
        if "MATLAB_object_decode" in item.attrs and kind not in PLAIN_CLASSES and path[0] != "#":
            opaque[path.replace("/", ".")] = kind or "object"

    if source.head.startswith(b"MATLAB 5"):
        _check_sizes(source)
        _refuse_fatal(source)
        variables = dict(_flatten("", read_mat(str(source.path)), opaque))
    else:
        with source.open() as stream:
            datasets = checked_datasets(stream)
            check_growth(source, 8 * sum(dataset.size for dataset in datasets.values()))
            h5py.File(stream, "r").visititems(note_object)
        # The order of variables in HDF5 is arbitrary.
        variables = dict(sorted(_flatten("", read_mat(str(source.path)), opaque)))
    arrays = {name: value for name, value in variables.items() if name not in opaque}
    objects = ", ".join(f"{name!r} ({kind})" for name, kind in opaque.items())
    if opaque and not any(value.size > 1 for value in arrays.values()):
        raise unreadable(
            source.name,
            f"it holds objects that only MATLAB can open: {objects}",
            needed="vectors of numbers, alone or in a structure",
            remedy=SAVING_ADVICE,
        )
    table = table_of(source, arrays)
    if not opaque:
        return table
    text = f"{objects} are objects that only MATLAB can open, and are not read. {SAVING_ADVICE}"
    statement = finding("opaque", text, place=next(iter(opaque)))
    return replace(table, statements=(statement, *table.statements))


def _check_sizes(source: Source) -> None:
    """Refuse variables of implausible size, also in structures."""
    from scipy.io import whosmat

    # SciPy fails for objects, which have no size; their elements are counted below.
    with suppress(TypeError):
        variables = whosmat(str(source.path))
        check_growth(source, 8 * sum(int(np.prod(s, dtype=object)) for _, s, _ in variables))
    total = 0
    with source.open() as stream:
        order = ">" if stream.read(HEADER_SIZE)[126:128] == b"MI" else "<"
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            inflate = zlib.decompressobj()
            while size > 0 and (content := stream.read(min(size, PIECE_SIZE))):
                size -= len(content)
                total += 0 if kind == COMPRESSED else len(content)
                while kind == COMPRESSED and content and not inflate.eof:
                    total += len(inflate.decompress(content, PIECE_SIZE))
                    content = inflate.unconsumed_tail
                    check_growth(source, 8 * total)
                # Numbers are stored in the smallest possible type, and read as doubles.
                check_growth(source, 8 * total)


def _refuse_fatal(source: Source) -> None:
    """Refuse a file on which SciPy ends the process: it does so for unknown types of numbers."""
    program = "import sys, scipy.io; scipy.io.loadmat(sys.argv[1])"
    command = [sys.executable, "-c", program, str(source.path)]
    status = subprocess.run(command, capture_output=True, check=False).returncode
    if status not in (0, 1):  # 1 after an exception, which is reported with its text
        raise unreadable(
            source.name,
            "it is damaged: an element has an unknown type",
            needed="a complete MATLAB file",
            remedy="Copy or save it again.",
        )


def _flatten(
    prefix: str, variables: Mapping[str, object], opaque: dict[str, str]
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the variables, and fields as ``structure.field``; add objects to ``opaque``."""
    for key, value in variables.items():
        if str(key).startswith(("__", "#")):
            continue
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping) and set(value) >= OBJECT_FIELDS:
            texts = []
            for content in (value["s0"], value["s2"]):
                is_sequence = isinstance(content, list | tuple | np.ndarray) and len(content)
                text = content[0] if is_sequence else content
                texts.append(
                    text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
                )
            opaque[texts[0] or name] = texts[1]
        elif isinstance(value, Mapping):
            yield from _flatten(name, value, opaque)
        else:
            yield name, value if isinstance(value, np.ndarray) else np.asarray(value)


READER = Reader(
    name="MATLAB",
    usual_suffixes=(".mat",),
    # The text at the start of a file stands also before the HDF5 of version 7.3.
    recognises=lambda source: (
        source.head.startswith(b"MATLAB ")
        or (source.head.startswith(SIGNATURE) and source.suffix == ".mat")
    ),
    read=read,
    library=True,
    extra="io",
)
