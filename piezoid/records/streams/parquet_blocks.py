"""Parquet in blocks: batch by batch, never more of a row group than a batch needs."""

from collections.abc import Iterator
from typing import Any

from piezoid.records.readers import parquet
from piezoid.records.readers.foreign import reading
from piezoid.records.readers.source import Source
from piezoid.records.streams.format import Arrays, BlockFormat, recut, tables_of
from piezoid.records.table import RawTable

_BUFFER = 1 << 20  # bytes of a column chunk that are held; 0 would hold all of it


def blocks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the numeric columns of a file, block by block."""
    with reading(source, "Parquet"), source.open() as stream:
        import pyarrow.types as types
        from pyarrow.parquet import ParquetFile

        file = ParquetFile(stream, buffer_size=_BUFFER, pre_buffer=False)
        fields = [
            field
            for field in file.schema_arrow
            if types.is_floating(field.type) or types.is_integer(field.type)
        ]
        parquet.check_footer(source, file.metadata, len(fields), whole=False)
        units = {f.name: (f.metadata or {}).get(b"unit", b"").decode("utf-8") for f in fields}
        pieces = _pieces(file, list(units), rows)
        yield from tables_of(source, "Parquet", recut(pieces, rows), units=units)


def _pieces(file: Any, names: list[str], rows: int) -> Iterator[Arrays]:
    for batch in file.iter_batches(batch_size=rows, columns=names, use_threads=False):
        yield {name: batch.column(name).to_numpy(zero_copy_only=False) for name in names}


FORMAT = BlockFormat(reader=parquet.READER, blocks=blocks)
