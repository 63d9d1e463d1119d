"""Apache Parquet: named columns, units in the names or in a field's metadata."""

from typing import Any

from piezoid.records.readers.foreign import reading, table_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_columns, check_growth
from piezoid.records.table import RawTable


def read(source: Source) -> RawTable:
    """Read every column of numbers or times."""
    with reading(source, "Parquet"), source.open() as stream:
        import pyarrow.types as types
        from pyarrow.parquet import ParquetFile

        file = ParquetFile(stream)
        numeric = [
            field
            for field in file.schema_arrow
            if types.is_floating(field.type)
            or types.is_integer(field.type)
            or types.is_timestamp(field.type)
            or types.is_duration(field.type)
        ]
        check_footer(source, file.metadata, len(numeric))
        # Only these: a text of a megabyte that every row repeats is a small file as well.
        table = file.read(columns=[field.name for field in numeric])
        arrays, units = {}, {}
        for field in numeric:
            column = table.column(field.name).combine_chunks()
            arrays[field.name] = column.to_numpy(zero_copy_only=False)
            units[field.name] = (field.metadata or {}).get(b"unit", b"").decode("utf-8")
    return table_of(source, "Parquet", arrays, units=units)


def check_footer(source: Source, metadata: Any, numeric: int, *, whole: bool = True) -> None:
    """Refuse by the footer what would fill memory or disk, before anything is read."""
    check_columns(source.name, metadata.num_columns)
    check_growth(source, 8 * metadata.num_rows * numeric, whole=whole)
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    check_growth(source, sum(group.total_byte_size for group in groups), whole=whole)


READER = Reader(
    name="Parquet",
    suffixes=(".parquet",),
    recognises=lambda source: source.head.startswith(b"PAR1"),
    read=read,
)
