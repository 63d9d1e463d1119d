"""Apache Parquet: named columns, units in the names or in a field's metadata."""

from collections.abc import Iterator
from typing import Any

from piezoid.records.readers.optional_readers import chunk_tables, reading, table_of
from piezoid.records.readers.reader import Arrays, Reader, overlapping_chunks
from piezoid.records.readers.source import Source, check_columns, check_growth
from piezoid.records.table import RawTable

_BUFFER = 1 << 20  # bytes of a column chunk held while reading in chunks; 0 would hold all of it


def read(source: Source) -> RawTable:
    """Read every column of numbers or times."""
    with reading(source, "Parquet"), source.open() as stream:
        import pyarrow.types as types
        from pyarrow.parquet import ParquetFile

        file = ParquetFile(stream)
        fields = [
            field
            for field in file.schema_arrow
            if _is_number(field.type)
            or types.is_timestamp(field.type)
            or types.is_duration(field.type)
        ]
        _check_footer(source, file.metadata, len(fields))
        # Only these: a text of a megabyte that every row repeats is a small file as well.
        table = file.read(columns=[field.name for field in fields])
        arrays = {
            field.name: table.column(field.name).combine_chunks().to_numpy(zero_copy_only=False)
            for field in fields
        }
    return table_of(source, "Parquet", arrays, units=_units(fields))


def read_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the columns of numbers batch by batch, never more of a row group than needed."""
    with reading(source, "Parquet"), source.open() as stream:
        from pyarrow.parquet import ParquetFile

        file = ParquetFile(stream, buffer_size=_BUFFER, pre_buffer=False)
        fields = [field for field in file.schema_arrow if _is_number(field.type)]
        _check_footer(source, file.metadata, len(fields), whole=False)
        units = _units(fields)
        chunks = overlapping_chunks(_batches(file, list(units), rows), rows)
        yield from chunk_tables(source, "Parquet", chunks, units=units)


def _is_number(kind: Any) -> bool:
    import pyarrow.types as types

    return bool(types.is_floating(kind) or types.is_integer(kind))


def _units(fields: list[Any]) -> dict[str, str]:
    return {f.name: (f.metadata or {}).get(b"unit", b"").decode("utf-8") for f in fields}


def _batches(file: Any, names: list[str], rows: int) -> Iterator[Arrays]:
    for batch in file.iter_batches(batch_size=rows, columns=names, use_threads=False):
        yield {name: batch.column(name).to_numpy(zero_copy_only=False) for name in names}


def _check_footer(source: Source, metadata: Any, columns: int, *, whole: bool = True) -> None:
    """Refuse by the footer what would fill memory or disk, before anything is read."""
    check_columns(source.name, metadata.num_columns)
    check_growth(source, 8 * metadata.num_rows * columns, whole=whole)
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    check_growth(source, sum(group.total_byte_size for group in groups), whole=whole)


READER = Reader(
    name="Parquet",
    suffixes=(".parquet",),
    recognises=lambda source: source.head.startswith(b"PAR1"),
    read=read,
    read_chunks=read_chunks,
    extra="io",
)
