"""MATLAB files, version 5 to 7.3: vectors of the workspace, or of the fields of a structure."""

from collections.abc import Iterator, Mapping

import numpy as np

from piezoid.records.readers.foreign import reading, table_of
from piezoid.records.readers.hdf5 import check_datasets
from piezoid.records.readers.hdf5_trees import SIGNATURE
from piezoid.records.readers.matlab_growth import check_matlab_growth
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_growth, unreadable
from piezoid.records.table import RawTable


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
        arrays = dict(_flat("", read_mat(str(source.path))))
    return table_of(source, "MATLAB", arrays)


def _check_sizes(source: Source) -> None:
    """Refuse what would not fit into memory by the sizes declared, before anything is read."""
    if source.head.startswith(b"MATLAB 5"):
        from scipy.io import whosmat

        found = whosmat(str(source.path))
        check_growth(source, 8 * sum(int(np.prod(s, dtype=object)) for _, s, _ in found))
        check_matlab_growth(source)
    else:
        check_datasets(source)


def _flat(prefix: str, held: Mapping[str, object]) -> Iterator[tuple[str, object]]:
    for key, value in held.items():
        if str(key).startswith(("__", "#")):
            continue
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, Mapping):
            yield from _flat(name, value)
        else:
            yield name, value if isinstance(value, np.ndarray) else np.asarray(value)


READER = Reader(name="MATLAB", suffixes=(".mat",), recognises=recognises, read=read)
