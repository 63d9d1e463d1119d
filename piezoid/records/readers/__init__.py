"""Readers: one file per format, from a file to a `RawTable`. Start at reader.py.

A new format is one file here and one line in `READERS`.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from piezoid.errors import LabFileError
from piezoid.records.readers import (
    archive,
    excel,
    gcs_array,
    hdf5,
    igor,
    jpk,
    lvm,
    matlab,
    nanonis,
    numpy_files,
    parquet,
    rigol,
    tdms,
    tektronix,
    text_table,
)
from piezoid.records.readers.reader import Reader, reading
from piezoid.records.readers.source import Source, TextFormat, open_source, unreadable
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension

# Asked in this order, by content; the first that recognises a file reads it. The text table takes
# whatever is left, so it stands last.
READERS: tuple[Reader, ...] = (
    numpy_files.NPY,
    numpy_files.NPZ,
    excel.READER,
    jpk.READER,
    igor.READER,
    archive.READER,
    matlab.READER,
    hdf5.READER,
    parquet.READER,
    tdms.READER,
    lvm.READER,
    nanonis.READER,
    rigol.READER,
    tektronix.READER,
    tektronix.ABOVE,
    gcs_array.READER,
    text_table.READER,
)


def read_table(path: Path, text: TextFormat | None = None) -> RawTable:
    """Read a file of any known format as a table of labelled columns, with NaN for missing cells.

    text  how lab.toml says that it is written

    Raises ``UnreadableFileError`` for a file that is missing, damaged or of no known format, and
    ``LabFileError`` where something is said of the writing of a file that is no text.
    """
    source = replace(open_source(path), text=text or TextFormat())
    reader = next((reader for reader in READERS if reader.recognises(source)), None)
    if reader is None:
        raise unreadable(
            source.name,
            f"no known format starts with the bytes {source.head[:8].hex(' ')}",
            needed=f"one of {', '.join(reader.name for reader in READERS)}",
            remedy="Export the recording as CSV.",
        )
    if source.text.keys and not reader.is_written:
        raise LabFileError(
            f"lab.toml: {', '.join(source.text.keys)} of {source.name} is declared, which is "
            f"{reader.name}",
            needed="a text table: every other format says itself how it is written",
            remedy="Leave it out.",
        )
    if reader.library:
        with reading(source, reader.name, reader.extra):
            table = reader.read(source)
    else:
        table = reader.read(source)
    table = _of_file(table, source, reader)
    is_swept = not table.independent and is_approach_curve(table)
    return replace(table, independent=table.columns[0].label) if is_swept else table


def read_table_in_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the chunks of a file, or refuse a format that is only read whole.

    rows  of a chunk, about
    """
    reader = next((reader for reader in READERS if reader.recognises(source)), None)
    if reader is None or reader.read_chunks is None:
        formats = ", ".join(r.name for r in READERS if r.read_chunks is not None)
        raise unreadable(
            source.name,
            f"it is {'of no known format' if reader is None else reader.name}",
            needed=f"one of {formats}, to be read in chunks",
            remedy="Export the recording in one of these formats, or cut it into files that fit "
            "into memory.",
        )
    if source.packed and not reader.reads_gzip:
        raise unreadable(
            source.name,
            f"it is {reader.name} packed by gzip, which can only be read from front to back",
            needed="the file itself, to be read in chunks",
            remedy="Unpack it with gunzip; or read it whole where it fits into memory.",
        )
    with reading(source, reader.name, reader.extra):
        for table in reader.read_chunks(source, rows):
            yield _of_file(table, source, reader)


def _of_file(table: RawTable, source: Source, reader: Reader) -> RawTable:
    return replace(table, name=source.name, digest=source.digest, format=reader.name)


def is_approach_curve(table: RawTable) -> bool:
    """Tell whether a table holds a height and currents, without a clock."""
    units = [column.heading.unit for column in table.columns]
    height, *further = [None if unit is None else unit.dimension for unit in units]
    is_clocked = table.sampling_rate_Hz is not None
    return height is Dimension.LENGTH and set(further) == {Dimension.CURRENT} and not is_clocked
