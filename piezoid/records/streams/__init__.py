"""Streams: recordings larger than memory, read in blocks. Start at spool.py.

A new format is one file here and one line in `FORMATS`.
"""

from piezoid.records.streams import hdf5_blocks, parquet_blocks, tdms_blocks, text_blocks
from piezoid.records.streams.format import BlockFormat

FORMATS: tuple[BlockFormat, ...] = (
    parquet_blocks.FORMAT,
    hdf5_blocks.FORMAT,
    tdms_blocks.FORMAT,
    text_blocks.FORMAT,
)
