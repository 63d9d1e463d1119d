"""Apache Parquet: named columns, units in the names or in a field's metadata."""

from piezoid.records.readers.foreign import reading, table_of
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, check_size
from piezoid.records.table import RawTable


def read(source: Source) -> RawTable:
    """Read every numeric column."""
    with reading(source, "Parquet"), source.open() as stream:
        import pyarrow.types as types
        from pyarrow.parquet import ParquetFile

        file = ParquetFile(stream)
        check_size(source.name, 8 * file.metadata.num_rows * file.metadata.num_columns)
        table = file.read()
        arrays, units = {}, {}
        for field in table.schema:
            if types.is_floating(field.type) or types.is_integer(field.type):
                column = table.column(field.name).combine_chunks()
                arrays[field.name] = column.to_numpy(zero_copy_only=False)
                units[field.name] = (field.metadata or {}).get(b"unit", b"").decode("utf-8")
    return table_of(source, "Parquet", arrays, units=units)


READER = Reader(
    name="Parquet",
    suffixes=(".parquet",),
    recognises=lambda source: source.head.startswith(b"PAR1"),
    read=read,
)
