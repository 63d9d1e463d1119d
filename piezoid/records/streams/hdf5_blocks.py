"""HDF5 in blocks: the datasets that have a row for each sample, slice by slice."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from piezoid.records.readers import hdf5
from piezoid.records.readers.foreign import reading
from piezoid.records.readers.hdf5_trees import check_trees
from piezoid.records.readers.source import Source, check_growth
from piezoid.records.streams.format import Arrays, BlockFormat, recut, tables_of
from piezoid.records.table import RawTable


def blocks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the numeric datasets of most rows' length, block by block; others are no columns."""
    with reading(source, "HDF5"), source.open() as stream:
        check_trees(stream)
        held = hdf5.named_datasets(stream)
        lengths = Counter(max(item.shape, default=0) for item in held.values() if item.size > 1)
        length = max(sorted(lengths), key=lengths.__getitem__, default=0)
        columns = {name: item for name, item in held.items() if item.shape[:1] == (length,)}
        check_growth(source, 8 * sum(item.size for item in columns.values()), whole=False)
        units = {name: hdf5.unit_of_dataset(item) for name, item in columns.items()}
        pieces = _pieces(columns, length, rows)
        yield from tables_of(source, "HDF5", recut(pieces, rows), units=units)


def _pieces(columns: Mapping[str, Any], length: int, rows: int) -> Iterator[Arrays]:
    for first in range(0, length, rows):
        yield {name: item[first : first + rows] for name, item in columns.items()}


FORMAT = BlockFormat(reader=hdf5.READER, blocks=blocks)
