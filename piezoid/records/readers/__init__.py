"""Readers: one file per format, from a file to a `RawTable`. Start at reader.py.

A new format is one file here and one line in `READERS`.
"""

from collections.abc import Iterator
from contextlib import nullcontext
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
    oscilloscopes,
    parquet,
    tdms,
    text_table,
)
from piezoid.records.readers.reader import (
    Reader,
    Source,
    TextFormat,
    library_errors,
    open_source,
    unreadable,
)
from piezoid.records.table import RawTable
from piezoid.records.units import Dimension

# The first reader that recognises the content of a file reads it. The text table accepts every
# other file and is the last.
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
    oscilloscopes.RIGOL,
    oscilloscopes.TEKTRONIX,
    oscilloscopes.TEKTRONIX_ABOVE,
    gcs_array.READER,
    text_table.READER,
)


def read_table(path: Path, text: TextFormat | None = None) -> RawTable:
    """Read a file of any known format as a table of labelled columns, with NaN for missing cells.

    text  layout of a text table, as declared in lab.toml

    Raises ``UnreadableFileError`` for a file that is missing, damaged or of no known format, and
    ``LabFileError`` for a declared layout of a file in another format than a text table.
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
    if source.text.entries and not reader.has_text_layout:
        raise LabFileError(
            f"lab.toml: {', '.join(source.text.entries)} of {source.name} is declared, which is "
            f"{reader.name}",
            needed="a text table: the layout of every other format is fixed",
            remedy="Leave it out.",
        )
    with library_errors(source, reader) if reader.library else nullcontext():
        table = reader.read(source)
    is_swept = not table.independent and is_approach_curve(table)
    return replace(
        table,
        name=source.name,
        digest=source.digest,
        format=reader.name,
        independent=table.columns[0].label if is_swept else table.independent,
    )


def read_table_in_chunks(source: Source, rows: int) -> Iterator[RawTable]:
    """Yield the chunks of a file; refuse formats that are only read as a whole.

    rows  a chunk has so many to twice as many, and only the last one may have fewer

    Every chunk begins with the last row of the previous one, so that a gap between two chunks lies
    inside one of them.
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
    if source.is_gzip and not reader.has_text_layout:
        raise unreadable(
            source.name,
            f"it is {reader.name} compressed by gzip, which can only be read from front to back",
            needed="the file itself, to be read in chunks",
            remedy="Unpack it with gunzip; or read it whole if it fits into memory.",
        )
    with library_errors(source, reader):
        chunk: RawTable | None = None
        for table in reader.read_chunks(source, rows):
            table = replace(table, name=source.name, digest=source.digest, format=reader.name)
            if chunk is None or chunk.rows + table.rows < 2 * rows:  # a short remainder
                chunk = table if chunk is None else chunk.followed_by(table)
                continue
            yield chunk
            last_row = chunk.part(slice(chunk.rows - 1, chunk.rows), source.name)
            chunk = replace(last_row, statements=()).followed_by(table)
        if chunk is not None:
            yield chunk


def is_approach_curve(table: RawTable) -> bool:
    """Return whether a table holds a height and currents, without a clock."""
    units = [column.heading.unit for column in table.columns]
    height, *further = [None if unit is None else unit.dimension for unit in units]
    is_clocked = table.sampling_rate_Hz is not None
    return height is Dimension.LENGTH and set(further) == {Dimension.CURRENT} and not is_clocked
