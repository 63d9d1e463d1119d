"""Readers: one file per format, from a file to a `RawTable`. Start at reader.py.

A new format is one file here and one line in `READERS`.
"""

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
from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import TextFormat, open_source, unreadable
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
    """Read any file piezoid knows as a table of labelled columns, NaN and all.

    text  how lab.toml says that it is written

    Raises ``UnreadableFileError`` for a file that is missing, damaged or of no known format, and
    ``LabFileError`` where something is said of the writing of a file that is no text.
    """
    source = replace(open_source(path), text=text or TextFormat())
    for reader in READERS:
        if reader.recognises(source):
            if source.text.keys and not reader.is_written:
                raise LabFileError(
                    f"lab.toml: {', '.join(source.text.keys)} of {source.name} is declared, which "
                    f"is {reader.name}",
                    needed="a text table: every other format says itself how it is written",
                    remedy="Leave it out.",
                )
            return _with_swept_height(reader.read(source))
    raise unreadable(
        source.name,
        f"no known format starts with the bytes {source.head[:8].hex(' ')}",
        needed=f"one of {', '.join(reader.name for reader in READERS)}",
        remedy="Export the recording as CSV.",
    )


def _with_swept_height(table: RawTable) -> RawTable:
    """Name the height as what an approach curve is a function of."""
    if table.independent or not is_approach_curve(table):
        return table
    return replace(table, independent=table.columns[0].label)


def is_approach_curve(table: RawTable) -> bool:
    """Tell whether a table holds a height and currents over it, without any clock."""
    units = [column.heading.unit for column in table.columns]
    height, *others = [None if unit is None else unit.dimension for unit in units]
    is_clocked = table.sampling_rate_Hz is not None
    return height is Dimension.LENGTH and set(others) == {Dimension.CURRENT} and not is_clocked
