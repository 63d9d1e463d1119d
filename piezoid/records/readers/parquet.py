"""Apache Parquet: named columns, units in the names or in a field's metadata."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from piezoid.records.readers.named_arrays import table_of
from piezoid.records.readers.reader import Reader, Source, check_columns, check_growth
from piezoid.records.table import Column, RawTable

_BUFFER = 1 << 20  # bytes of a column chunk in memory while reading in chunks; 0: all of it


def read(source: Source) -> RawTable:
    """Read every column of numbers or times."""
    import pyarrow.types as types
    from pyarrow.parquet import ParquetFile

    with source.open() as stream:
        file = ParquetFile(stream)
        times = (types.is_timestamp, types.is_duration)
        units = _checked_units(source, file, (types.is_floating, types.is_integer, *times))
        # Other columns are not read: a long text repeated in every row makes a small file.
        table = file.read(columns=list(units))
    columns = {name: table.column(name).combine_chunks() for name in units}
    arrays = {name: column.to_numpy(zero_copy_only=False) for name, column in columns.items()}
    return table_of(source, arrays, units=units)


def read_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the columns of numbers batch by batch, with at most one batch in memory."""
    import pyarrow.types as types
    from pyarrow.parquet import ParquetFile

    with source.open() as stream:
        file = ParquetFile(stream, buffer_size=_BUFFER, pre_buffer=False)
        numbers = (types.is_floating, types.is_integer)
        units = _checked_units(source, file, numbers)
        batches = file.iter_batches(batch_size=rows, columns=list(units), use_threads=False)
        for batch in batches:
            columns = (
                Column(
                    number=k,
                    label=name,
                    declared_unit=unit,
                    values=batch.column(name).to_numpy(zero_copy_only=False),
                )
                for k, (name, unit) in enumerate(units.items(), 1)
            )
            yield RawTable(columns=tuple(columns))


def _checked_units(
    source: Source, file: Any, kinds: Iterable[Callable[[Any], bool]]
) -> dict[str, str]:
    """Return the units of the columns of some types by name; empty for an unknown unit.

    Refuses files that would fill memory or disk, by the sizes in the footer.
    """
    units = {
        field.name: (field.metadata or {}).get(b"unit", b"").decode("utf-8")
        for field in file.schema_arrow
        if any(is_kind(field.type) for is_kind in kinds)
    }
    metadata = file.metadata
    check_columns(source.name, metadata.num_columns)
    check_growth(source, 8 * metadata.num_rows * len(units))
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    check_growth(source, sum(group.total_byte_size for group in groups))
    return units


READER = Reader(
    name="Parquet",
    usual_suffixes=(".parquet",),
    recognises=lambda source: source.head.startswith(b"PAR1"),
    read=read,
    read_chunks=read_chunks,
    library=True,
    extra="io",
)
