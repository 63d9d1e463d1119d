"""Readers: one file per format, from a file to a `RawTable`. Start at reader.py.

A new format is one file here and one line in `READERS`.
"""

from pathlib import Path

from piezoid.records.readers import (
    gcs_array,
    hdf5,
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
from piezoid.records.readers.source import open_source, unreadable
from piezoid.records.table import RawTable

# Asked in this order, by content; the first that recognises a file reads it. The text table takes
# whatever is left, so it stands last.
READERS: tuple[Reader, ...] = (
    numpy_files.NPY,
    numpy_files.NPZ,
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


def read_table(path: Path) -> RawTable:
    """Read any file piezoid knows as a table of labelled columns, NaN and all.

    Raises ``UnreadableFileError`` for a file that is missing, damaged or of no known format.
    """
    source = open_source(path)
    for reader in READERS:
        if reader.recognises(source):
            return reader.read(source)
    raise unreadable(
        source.name,
        f"no known format starts with the bytes {source.head[:8].hex(' ')}",
        needed=f"one of {', '.join(reader.name for reader in READERS)}",
        remedy="Export the recording as CSV.",
    )
