"""HDF5: the numeric vectors of all groups, units from the attribute ``unit`` or ``units``.

The search trees of a file are checked before the library opens it. Nodes of version 1 trees
contain the addresses of their neighbours; the library follows these addresses without a limit in
compiled code, and never returns from a damaged file with a cycle.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, BinaryIO

from piezoid.records.readers.named_arrays import commonest_length, table_of
from piezoid.records.readers.reader import MAX_COLUMNS, Reader, Source, check_growth
from piezoid.records.table import RawTable

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MAX_DEPTH = 32  # nested groups; the library takes minutes for some thousand
_UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units", "UNIT")
_NODE = b"TREE"
_LINKS_AT = 8  # bytes of a node before the addresses of its left and its right neighbour
_FIRST_BASE = 512  # the signature is at 0 or, behind a user block, at 512, 1024, 2048 ...
_PIECE = 1 << 20


def read(source: Source) -> RawTable:
    """Read every numeric dataset; ambiguous names are prefixed by their group."""
    with source.open() as stream:
        datasets = checked_datasets(stream)
        check_growth(source, 8 * sum(dataset.size for dataset in datasets.values()))
        arrays = {name: dataset[()] for name, dataset in datasets.items()}
        return table_of(source, arrays, units=_units_of(datasets))


def read_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the numeric datasets of the commonest length, slice by slice."""
    with source.open() as stream:
        datasets = checked_datasets(stream)
        length = commonest_length(max(d.shape, default=0) for d in datasets.values() if d.size > 1)
        columns = {name: d for name, d in datasets.items() if d.shape[:1] == (length,)}
        check_growth(source, 8 * sum(d.size for d in columns.values()))
        units = _units_of(columns)
        for first, stop in pairwise([*range(0, max(length - rows, 1), rows), length]):
            arrays = {name: dataset[first:stop] for name, dataset in columns.items()}
            yield table_of(source, arrays, units=units)


def checked_datasets(stream: BinaryIO) -> dict[str, Any]:
    """Return the datasets by name, without their numbers; refuse a file with a cycle.

    Ambiguous names are prefixed by their group.
    """
    import h5py

    check_trees(stream)
    datasets: dict[str, Any] = {}

    def keep(path: str, item: Any) -> None:
        if path.count("/") > _MAX_DEPTH:
            raise ValueError(f"its groups lie more than {_MAX_DEPTH} deep in one another")
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "biuf":
            return
        # The digest of this file does not cover other files, and a pipe may never end.
        if item.external or item.is_virtual:
            raise ValueError(f"the numbers of {path} lie in other files")
        if len(datasets) == MAX_COLUMNS:
            raise ValueError(f"it holds more than {MAX_COLUMNS} datasets")
        datasets[path] = item

    h5py.File(stream, "r").visititems(keep)
    short = [path.rsplit("/", 1)[-1] for path in datasets]
    return {
        name if short.count(name) == 1 else path: dataset
        for name, (path, dataset) in zip(short, datasets.items(), strict=True)
    }


def _units_of(datasets: Mapping[str, Any]) -> dict[str, str]:
    units: dict[str, str] = {}
    for name, dataset in datasets.items():
        key = next((key for key in _UNIT_ATTRIBUTES if key in dataset.attrs), None)
        unit = "" if key is None else dataset.attrs[key]
        units[name] = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
    return units


def check_trees(stream: BinaryIO) -> None:
    """Raise ``ValueError`` if the nodes of a search tree form a cycle."""
    # Addresses count from the signature, which follows the user block.
    size = stream.seek(0, 2)
    base = 0
    while base < size:
        stream.seek(base)
        if stream.read(len(SIGNATURE)) == SIGNATURE:
            break
        base = 2 * base or _FIRST_BASE
    stream.seek(base)
    head = stream.read(len(SIGNATURE) + 6)
    if len(head) < len(SIGNATURE) + 6:
        return  # the library reports that this is not an HDF5 file
    # The width of an address: at byte 13 of the superblock, since its version 2 at byte 9.
    width = head[13] if head[8] < 2 else head[9]
    # The address of the right neighbour of each node.
    right: dict[int, int] = {}
    length = _LINKS_AT + 2 * width
    stream.seek(base)
    buffer, address = b"", 0
    while piece := stream.read(_PIECE):
        buffer += piece
        position = buffer.find(_NODE)
        while 0 <= position <= len(buffer) - length:
            link = buffer[position + length - width : position + length]
            right[address + position] = int.from_bytes(link, "little")
            position = buffer.find(_NODE, position + 1)
        consumed = max(len(buffer) - length, 0) if position < 0 else position
        buffer, address = buffer[consumed:], address + consumed
    # A chain of neighbours that meets itself is a cycle.
    visited: set[int] = set()
    for first in right:
        chain: set[int] = set()
        node = first
        while node in right and node not in visited:
            if node in chain:
                raise ValueError(f"the search tree at byte {base + node} leads round in a ring")
            chain.add(node)
            node = right[node]
        visited |= chain


READER = Reader(
    name="HDF5",
    usual_suffixes=(".h5", ".hdf5"),
    recognises=lambda source: source.head.startswith(SIGNATURE),
    read=read,
    read_chunks=read_chunks,
    library=True,
    extra="io",
)
